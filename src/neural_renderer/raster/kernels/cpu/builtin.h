// The few names of Warp's own builtin.h that its code around a kernel in C++ needs on the CPU. Compilers find this file
// first: Warp's takes longer to compile than most kernels.
#pragma once

#include "crt.h"  // Warp's, with the functions of the C library

#define CUDA_CALLABLE
#define WP_FORCEINLINE inline __attribute__((always_inline))

namespace wp {

typedef int int32;

template <int N>
struct launch_bounds_t {
    unsigned int shape[N];
    size_t size, coord_mult;
};

template <bool LINEAR>
inline int linear_tid(size_t task, const launch_bounds_t<1>&) {
    return int(task);
}

inline int add(int a, int b) { return a + b; }

struct tile_shared_storage_t {};
static tile_shared_storage_t* shared_tile_storage;

}  // namespace wp
