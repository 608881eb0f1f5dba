"""The stage of `l3 simulate`, which simulates frames of scenes under several illuminants and writes a training set."""
