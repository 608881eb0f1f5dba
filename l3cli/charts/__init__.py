"""A colour chart in a mosaic: found, and its patches measured."""
