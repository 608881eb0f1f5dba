"""The renderer that uses OpenCL kernels."""
