"""The stage of `l3 render`, which renders raw frames with a transform table to pictures or video."""
