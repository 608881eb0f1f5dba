"""Raw frames and scenes, and what corrects them."""
