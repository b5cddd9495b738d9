"""Which bodies are there, and where they stand: by their tones, what they uncover, and the part drawn anew."""
