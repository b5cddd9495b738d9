"""Where a camera sits on a robot or in its cell."""
