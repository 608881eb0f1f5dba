"""Fixtures of all tests in this folder."""

from tests.helpers.charts import small_charts

__all__ = ["small_charts"]
