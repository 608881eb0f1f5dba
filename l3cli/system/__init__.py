"""File, lock, signal, resource-limit and text utilities that know nothing about cameras or pictures."""
