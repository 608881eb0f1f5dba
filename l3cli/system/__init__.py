"""Files, locks, signals, limits: what any program on this system needs, nothing of cameras."""
