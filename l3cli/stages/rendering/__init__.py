"""The stage of `l3 render`: it renders raw frames with a transform table to pictures or video."""
