"""Which bodies are there, and where: judged by tones, by what they would hide, and by drawing the part again."""
