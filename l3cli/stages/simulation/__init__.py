"""The simulation stage: camera × scenes × lights → training set (`simulate`)."""
