"""The `l3 render` stage, which renders raw frames with a transform table to pictures or video."""
