"""Float64 references of the operators in plain torch: slow, for tests of the kernels."""
