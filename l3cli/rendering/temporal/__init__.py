"""The temporal filter, which blends each mosaic with the previous frames before rendering (docs/method.md#temporal)."""
