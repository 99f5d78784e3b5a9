// Differences between compilers: Warp's (clang for the CPU, NVRTC for CUDA), and g++ or clang without Warp.
#pragma once

#if !defined(WP_NO_CRT) && !defined(__CUDACC_RTC__)  // Warp declares these functions itself
#include <math.h>
#include <stddef.h>
#include <string.h>
#endif

#if defined(__CUDA_ARCH__)
#define NR_ON_CUDA 1
#define NR_FUNC __device__ inline
#define NR_NOINLINE __device__ inline
#else
#define NR_ON_CUDA 0
#define NR_FUNC inline
// Not inlined on the CPU: a rare case would take registers from the loop around it, and a long function with two calls
// would take twice the time to compile.
#define NR_NOINLINE inline __attribute__((noinline))
#endif

// At the start of a function: on the CPU its products and sums may be fused, even across statements, or must not be
// fused, whatever the module's option says. On CUDA only the module's option counts.
#if defined(__clang__)
#define NR_FUSED _Pragma("clang fp contract(fast)")
#define NR_UNFUSED _Pragma("clang fp contract(off)")
// Before a loop: the compiler must not vectorise it.
#define NR_NO_VECTORS _Pragma("clang loop vectorize(disable) interleave(disable) unroll(disable)")
#else
#define NR_FUSED
#define NR_UNFUSED
#define NR_NO_VECTORS
#endif

namespace nr {

typedef long long int64;
typedef unsigned long long uint64;
typedef unsigned char byte;

constexpr bool ON_CUDA = NR_ON_CUDA;

template <class T>
struct Vec3 {
    T c[3];

    NR_FUNC T& operator[](int k) { return c[k]; }
    NR_FUNC const T& operator[](int k) const { return c[k]; }
    NR_FUNC Vec3& operator+=(const Vec3& other) {
        for (int k = 0; k < 3; ++k) c[k] += other.c[k];
        return *this;
    }
};

template <class T>
NR_FUNC Vec3<T> operator+(const Vec3<T>& a, const Vec3<T>& b) {
    return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}

template <class T>
NR_FUNC Vec3<T> operator-(const Vec3<T>& a, const Vec3<T>& b) {
    return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}

template <class T>
NR_FUNC Vec3<T> operator*(T scale, const Vec3<T>& a) {
    return {scale * a[0], scale * a[1], scale * a[2]};
}

// The product, component by component.
template <class T>
NR_FUNC Vec3<T> times(const Vec3<T>& a, const Vec3<T>& b) {
    return {a[0] * b[0], a[1] * b[1], a[2] * b[2]};
}

template <class T>
NR_FUNC T dot(const Vec3<T>& a, const Vec3<T>& b) {
    T sum = a[0] * b[0];
    for (int k = 1; k < 3; ++k) sum += a[k] * b[k];
    return sum;
}

typedef Vec3<float> vec3;
typedef Vec3<double> vec3d;

// Two numbers for each element of an array.
struct vec2 {
    float c[2];
    NR_FUNC float& operator[](int k) { return c[k]; }
    NR_FUNC const float& operator[](int k) const { return c[k]; }
};
struct vec2i {
    int c[2];
    NR_FUNC int& operator[](int k) { return c[k]; }
    NR_FUNC const int& operator[](int k) const { return c[k]; }
};

NR_FUNC float max(float a, float b) { return a > b ? a : b; }
NR_FUNC float min(float a, float b) { return a < b ? a : b; }
NR_FUNC int max(int a, int b) { return a > b ? a : b; }
NR_FUNC int min(int a, int b) { return a < b ? a : b; }

// x clamped to [low, high]; low for NaN.
NR_FUNC float clamp(float x, float low, float high) { return x > low ? (x < high ? x : high) : low; }

// Index into a batch that may be shorter than the images: entries past the end share the last one.
NR_FUNC int broadcast(int b, int images) { return b < images ? b : images - 1; }

// Sums of concurrent CUDA threads. On the CPU no two tasks write to the same address, so plain additions suffice.
NR_FUNC void atomic_add(float* to, float value) {
#if NR_ON_CUDA
    atomicAdd(to, value);
#else
    *to += value;
#endif
}
NR_FUNC void atomic_add(vec3* to, const vec3& value) {
    for (int k = 0; k < 3; ++k) atomic_add(&to->c[k], value[k]);
}
// Most lines of most faces add nothing, and a test is faster than an atomic.
NR_FUNC void atomic_add_nonzero(vec3* to, const vec3& value) {
    for (int k = 0; k < 3; ++k)
        if (value[k] != 0.0f) atomic_add(&to->c[k], value[k]);
}
// Add to a counter; returns its previous value.
NR_FUNC int64 atomic_add(int64* to, int64 value) {
#if NR_ON_CUDA
    return (int64)atomicAdd((unsigned long long*)to, (unsigned long long)value);
#else
    const int64 before = *to;
    *to += value;
    return before;
#endif
}

// The minimum over concurrent CUDA threads.
NR_FUNC void atomic_min(int64* to, int64 value) {
#if NR_ON_CUDA
    atomicMin(to, value);
#else
    if (value < *to) *to = value;
#endif
}

// The maximum over concurrent CUDA threads. Most threads find a greater value there, and a read is faster than an
// atomic.
NR_FUNC void atomic_max(int* to, int value) {
    if (*(volatile int*)to >= value) return;
#if NR_ON_CUDA
    atomicMax(to, value);
#else
    *to = value;
#endif
}

// Write ``value`` if the address holds ``expected``; returns its previous value. On the CPU no two tasks share it.
NR_FUNC int atomic_cas(int* to, int expected, int value) {
#if NR_ON_CUDA
    return atomicCAS(to, expected, value);
#else
    const int before = *to;
    if (before == expected) *to = value;
    return before;
#endif
}

// Write to an address to which several tasks may write the same value. On the CPU this compiles to a plain store, but
// without a data race in the sense of the C++ standard.
NR_FUNC void store_relaxed(int* to, int value) {
#if NR_ON_CUDA
    *to = value;
#else
    __atomic_store_n(to, value, __ATOMIC_RELAXED);
#endif
}

// The bits of a number. For positive numbers they have the same order as the numbers.
NR_FUNC int bits_of(float value) {
    int result;
    memcpy(&result, &value, sizeof(result));
    return result;
}

// Add to an address that only this task writes, if ``exclusive``; otherwise several tasks share it.
template <class T>
NR_FUNC void add(T* to, const T& value, bool exclusive) {
    if (exclusive) *to += value;
    else atomic_add(to, value);
}

// Add a product; on the CPU in one expression, so that it may be fused.
NR_FUNC void add_product(float* to, float a, float b) {
#if NR_ON_CUDA
    atomicAdd(to, a * b);
#else
    *to += a * b;
#endif
}

}  // namespace nr
