"""The `l3 simulate` stage, which simulates frames of scenes under several illuminants and writes a training set."""
