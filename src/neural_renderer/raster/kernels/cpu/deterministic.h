// Replaces Warp's header of this name, from which kernels in C++ need nothing.
