// What the kernels need of the compiler: Warp's (its CPU compiler is clang, its CUDA compiler NVRTC), g++ or clang
// alone.
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
// On the CPU a function of its own: a rare case would take registers from the usual one in its loop, and a long
// function that is called at two places would take twice the time to compile.
#define NR_NOINLINE inline __attribute__((noinline))
#endif

// Macros at the start of a function: on the CPU its own products and sums may be fused, across statements too, or are
// not fused, whatever the module's option. CUDA's compiler knows the module's option alone.
#if defined(__clang__)
#define NR_FUSED _Pragma("clang fp contract(fast)")
#define NR_UNFUSED _Pragma("clang fp contract(off)")
// Before a loop: it is not turned into vector instructions.
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

// The product of each component.
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

// Memory that a kernel gets for two or four numbers a place.
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

NR_FUNC float larger(float a, float b) { return a > b ? a : b; }
NR_FUNC float smaller(float a, float b) { return a < b ? a : b; }
NR_FUNC int larger(int a, int b) { return a > b ? a : b; }
NR_FUNC int smaller(int a, int b) { return a < b ? a : b; }

// The number in [low, high] that is nearest to x; low for NaN.
NR_FUNC float clamp(float x, float low, float high) { return x > low ? (x < high ? x : high) : low; }

// The image whose values image b has, of ``images`` images: its own, or the last one.
NR_FUNC int shared(int b, int images) { return b < images ? b : images - 1; }

// Sums of concurrent CUDA threads. On the CPU no two tasks write to one place, so that these are plain additions.
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
// Add to a count; returns what it was before.
NR_FUNC int64 atomic_add(int64* to, int64 value) {
#if NR_ON_CUDA
    return (int64)atomicAdd((unsigned long long*)to, (unsigned long long)value);
#else
    const int64 before = *to;
    *to += value;
    return before;
#endif
}

// The least number of concurrent CUDA threads.
NR_FUNC void atomic_min(int64* to, int64 value) {
#if NR_ON_CUDA
    atomicMin(to, value);
#else
    if (value < *to) *to = value;
#endif
}

// The largest number of concurrent CUDA threads. Most find a larger one there: a read is faster than an atomic.
NR_FUNC void atomic_max(int* to, int value) {
    if (*(volatile int*)to >= value) return;
#if NR_ON_CUDA
    atomicMax(to, value);
#else
    *to = value;
#endif
}

// Write ``value`` if the place holds ``expected``; returns what it held. On the CPU no two tasks share such a place.
NR_FUNC int atomic_cas(int* to, int expected, int value) {
#if NR_ON_CUDA
    return atomicCAS(to, expected, value);
#else
    const int before = *to;
    if (before == expected) *to = value;
    return before;
#endif
}

// Write to a place where several tasks may write the same value. On the CPU this is the same machine code as a plain
// store, but one that the language allows.
NR_FUNC void write_shared(int* to, int value) {
#if NR_ON_CUDA
    *to = value;
#else
    __atomic_store_n(to, value, __ATOMIC_RELAXED);
#endif
}

// The bits of a number. Those of positive numbers have their order.
NR_FUNC int bits_of(float value) {
    int result;
    memcpy(&result, &value, sizeof(result));
    return result;
}

// Add to a place that this task alone writes, if ``alone``, or to one that several tasks share.
template <class T>
NR_FUNC void add(T* to, const T& value, bool alone) {
    if (alone) *to += value;
    else atomic_add(to, value);
}

// Add a product: on the CPU in one expression, which may be fused.
NR_FUNC void add_product(float* to, float a, float b) {
#if NR_ON_CUDA
    atomicAdd(to, a * b);
#else
    *to += a * b;
#endif
}

}  // namespace nr
