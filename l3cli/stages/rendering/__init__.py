"""The render stage: raw frames through a table → pictures (`render`)."""
