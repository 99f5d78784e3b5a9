// SIMD vectors of 8 and 16 lanes with the operators of a single float, so that each formula is written once for both.
//
// A formula is a template over its number type F: float, floats8 or floats16. Comparisons return a mask (bool, or a
// vector of integers, -1 where true), by which `select` chooses. CUDA has single floats only: its threads are the
// lanes.
#pragma once

#include "platform.h"

// Whether the compiler has SIMD vectors.
#define NR_LANES !NR_ON_CUDA

namespace nr {

// Whether neighbouring threads do the work of the lanes of a vector.
constexpr bool THREADS_ARE_LANES = !NR_LANES;

template <class T>
NR_FUNC T select(bool mask, T yes, T no) {
    return mask ? yes : no;
}

// The same number in all lanes.
template <class F, class T>
NR_FUNC F all(T value) {
    return F{} + value;
}

// The types that belong to F: Mask for comparisons, Ints for integers, and Places for array offsets, which in a vector
// have 32 bits. WIDTH is the number of lanes.
template <class F>
struct Lanes;

template <>
struct Lanes<float> {
    typedef bool Mask;
    typedef int Ints;
    typedef int64 Places;
    static constexpr int WIDTH = 1;
};

// Index of the lowest set bit of a number other than 0.
NR_FUNC int lowest_bit(uint64 number) {
#if NR_LANES
    return __builtin_ctzll(number);
#else
    int n = 0;
    while (!(number >> n & 1)) ++n;
    return n;
#endif
}

// Element n of a vector; a single number is its own element.
NR_FUNC float lane(float value, int) { return value; }
NR_FUNC int lane(int value, int) { return value; }
NR_FUNC int64 lane(int64 value, int) { return value; }
NR_FUNC bool lane(bool value, int) { return value; }
NR_FUNC void set_lane(float& value, int, float to) { value = to; }

// The quotient of numbers far from overflow; on CUDA off by at most 2 in the last bit, because an exact division has a
// branch.
template <class F>
NR_FUNC F quotient(F a, F b) {
#if NR_ON_CUDA
    return __fdividef(a, b);
#else
    return a / b;
#endif
}

NR_FUNC float to_floats(int value) { return (float)value; }
NR_FUNC int to_ints(float value) { return (int)value; }
NR_FUNC float floor_of(float value) { return floorf(value); }
NR_FUNC bool any(bool mask) { return mask; }
NR_FUNC float sum(float value) { return value; }
NR_FUNC void load(const vec2* from, float* to) { to[0] = from[0][0], to[1] = from[0][1]; }
#if !NR_LANES
typedef float wide_floats;  // the widest vector, for loops over memory
#endif

// The index of each lane: 0, 1, 2, …
template <class Ints>
NR_FUNC Ints lane_numbers() {
    if constexpr (sizeof(Ints) == sizeof(int)) return 0;
    else {
        Ints result;
        for (int n = 0; n < (int)(sizeof(Ints) / sizeof(int)); ++n) result[n] = n;
        return result;
    }
}

// A mask of the lanes n for which test(n) is true.
template <class F, class Test>
NR_FUNC typename Lanes<F>::Mask mask_of(Test test) {
    if constexpr (Lanes<F>::WIDTH == 1) return test(0);
    else {
        typename Lanes<F>::Mask result;
        for (int n = 0; n < Lanes<F>::WIDTH; ++n) result[n] = test(n) ? -1 : 0;
        return result;
    }
}

// Contiguous numbers in memory.
template <class V, class T>
NR_FUNC V load(const T* from) {
    if constexpr (sizeof(V) == sizeof(T)) return *from;  // keeps the alignment
    V result;
    memcpy(&result, from, sizeof(result));
    return result;
}
template <class V, class T>
NR_FUNC void store(T* to, const V& values) {
    memcpy(to, &values, sizeof(values));
}

// Store the first ``count`` lanes contiguously.
template <class F>
NR_FUNC void store_first(float* to, const F& values, int count) {
    if constexpr (Lanes<F>::WIDTH == 1) *to = values;
    else if (count == Lanes<F>::WIDTH) store(to, values);
    else
        for (int n = 0; n < count; ++n) to[n] = values[n];
}

#if NR_LANES
#if defined(__clang__)
#define NR_VECTOR(type, n) __attribute__((ext_vector_type(n))) type
#else
#define NR_VECTOR(type, n) __attribute__((vector_size(4 * n))) type
#endif
typedef NR_VECTOR(float, 4) floats4;
typedef NR_VECTOR(float, 8) floats8;
typedef NR_VECTOR(int, 8) ints8;
typedef NR_VECTOR(float, 16) floats16;
typedef NR_VECTOR(int, 16) ints16;
#undef NR_VECTOR
typedef floats16 wide_floats;

template <>
struct Lanes<floats8> {
    typedef ints8 Mask;
    typedef ints8 Ints;
    typedef ints8 Places;
    static constexpr int WIDTH = 8;
};
template <>
struct Lanes<floats16> {
    typedef ints16 Mask;
    typedef ints16 Ints;
    static constexpr int WIDTH = 16;
};

inline floats8 select(ints8 mask, floats8 yes, floats8 no) { return mask ? yes : no; }
inline floats16 select(ints16 mask, floats16 yes, floats16 no) { return mask ? yes : no; }
inline ints8 select(ints8 mask, ints8 yes, ints8 no) { return mask ? yes : no; }
inline float lane(floats8 values, int n) { return values[n]; }
inline int lane(ints8 values, int n) { return values[n]; }
inline void set_lane(floats8& values, int n, float to) { values[n] = to; }
inline floats8 to_floats(ints8 values) { return __builtin_convertvector(values, floats8); }
inline floats16 to_floats(ints16 values) { return __builtin_convertvector(values, floats16); }
inline ints8 to_ints(floats8 values) { return __builtin_convertvector(values, ints8); }
inline floats8 floor_of(floats8 values) {
#if defined(__clang__)
    return __builtin_elementwise_floor(values);
#else
    for (int n = 0; n < 8; ++n) values[n] = floorf(values[n]);
    return values;
#endif
}

template <class Ints>
inline bool any_lane(Ints mask) {
#if defined(__clang__)
    return __builtin_reduce_or(mask) != 0;
#else
    int result = 0;
    for (int n = 0; n < (int)(sizeof(Ints) / sizeof(int)); ++n) result |= mask[n];
    return result != 0;
#endif
}
inline bool any(ints8 mask) { return any_lane(mask); }
inline bool any(ints16 mask) { return any_lane(mask); }

// The bits of a mask: bit n is lane n.
inline unsigned bits(ints8 mask) {
#if defined(__clang__)
    typedef bool bools8 __attribute__((ext_vector_type(8)));
    const bools8 each = __builtin_convertvector(mask, bools8);
    unsigned char result;
    memcpy(&result, &each, sizeof(result));
    return result;
#else
    unsigned result = 0;
    for (int n = 0; n < 8; ++n) result |= mask[n] ? 1u << n : 0u;
    return result;
#endif
}

inline float sum(floats8 v) { return v[0] + v[1] + v[2] + v[3] + (v[4] + v[5] + v[6] + v[7]); }
inline float sum(floats16 v) {
    const floats8 half = __builtin_shufflevector(v, v, 0, 1, 2, 3, 4, 5, 6, 7)
        + __builtin_shufflevector(v, v, 8, 9, 10, 11, 12, 13, 14, 15);
    return half[0] + half[4] + (half[2] + half[6]) + (half[1] + half[5] + (half[3] + half[7]));
}

// A vec3 as a vector, whose last lane is 0.
inline floats4 as_vector(const vec3& value) {
    floats4 result = {};
    memcpy(&result, value.c, sizeof(value));
    return result;
}
inline vec3 as_vec3(floats4 value) { return {value[0], value[1], value[2]}; }

// Two numbers of each of eight contiguous pixels, deinterleaved.
inline void load(const vec2* from, floats8* to) {
    const floats8 u = load<floats8>(from->c), v = load<floats8>(from->c + 8);
    to[0] = __builtin_shufflevector(u, v, 0, 2, 4, 6, 8, 10, 12, 14);
    to[1] = __builtin_shufflevector(u, v, 1, 3, 5, 7, 9, 11, 13, 15);
}

// Three channels of eight contiguous pixels, as in an array of vec3, deinterleaved.
inline void load(const vec3* from, floats8* to) {
    const float* at = from->c;
    const floats8 u = load<floats8>(at), v = load<floats8>(at + 8), w = load<floats8>(at + 16);
    const floats8 a = __builtin_shufflevector(u, v, 0, 3, 6, 9, 12, 15, -1, -1);
    const floats8 b = __builtin_shufflevector(u, v, 1, 4, 7, 10, 13, -1, -1, -1);
    const floats8 c = __builtin_shufflevector(u, v, 2, 5, 8, 11, 14, -1, -1, -1);
    to[0] = __builtin_shufflevector(a, w, 0, 1, 2, 3, 4, 5, 10, 13);
    to[1] = __builtin_shufflevector(b, w, 0, 1, 2, 3, 4, 8, 11, 14);
    to[2] = __builtin_shufflevector(c, w, 0, 1, 2, 3, 4, 9, 12, 15);
}
inline void store(vec3* to, floats8 a, floats8 b, floats8 c) {
    floats8 u = __builtin_shufflevector(a, b, 0, 8, -1, 1, 9, -1, 2, 10);
    floats8 v = __builtin_shufflevector(a, b, -1, 3, 11, -1, 4, 12, -1, 5);
    floats8 w = __builtin_shufflevector(a, b, 13, -1, 6, 14, -1, 7, 15, -1);
    u = __builtin_shufflevector(u, c, 0, 1, 8, 3, 4, 9, 6, 7);
    v = __builtin_shufflevector(v, c, 10, 1, 2, 11, 4, 5, 12, 7);
    w = __builtin_shufflevector(w, c, 0, 13, 2, 3, 14, 5, 6, 15);
    store(to->c, u), store(to->c + 8, v), store(to->c + 16, w);
}
#endif  // NR_LANES

template <class F>
NR_FUNC F larger(F a, F b) {
    return select(a > b, a, b);
}
template <class F>
NR_FUNC F smaller(F a, F b) {
    return select(a < b, a, b);
}

// Like `lane`, but reads from memory; otherwise the compiler spills the whole vector for every element.
template <class V>
NR_FUNC decltype(lane(V{}, 0)) lane_in_memory(const V& values, int n) {
    return ((const decltype(lane(V{}, 0))*)&values)[n];
}

}  // namespace nr
