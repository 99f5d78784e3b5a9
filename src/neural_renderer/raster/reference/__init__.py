"""Float64 references of the operators in plain torch: slow, and what the tests compare the kernels with."""
