"""File, lock, signal, resource-limit and text utilities, which do not depend on cameras or pictures."""
