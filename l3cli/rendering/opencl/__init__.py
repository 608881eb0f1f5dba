"""Rendering with OpenCL kernels."""
