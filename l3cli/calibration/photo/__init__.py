"""Responsivities from raw photographs of a chart whose reflectances are known (docs/method.md#charts-in-photographs)."""
