"""The temporal filter, which blends a mosaic with the previous frames before it is rendered (docs/method.md#temporal)."""
