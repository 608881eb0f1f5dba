"""The simulation stage: it simulates frames of scenes under several illuminants, and writes a training set."""
