"""Rendering by OpenCL kernels."""
