"""Responsivities from raw photographs of a chart with known reflectances (docs/method.md#charts-in-photographs)."""
