// In place of Warp's header of this name, of which kernels in C++ need nothing.
