"""The OpenCL renderer."""
