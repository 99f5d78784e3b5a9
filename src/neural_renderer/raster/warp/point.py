"""Vectors of eight numbers in plain C++, and the substitution of statements in its text."""

import re

# Vectors of eight numbers, on the CPU; ``load`` and ``store`` three channels of eight pixels that lie side by side.
VECTORS = """
#if !defined(__CUDA_ARCH__)
struct Vectors {
    typedef float floats __attribute__((ext_vector_type(8)));
    typedef int ints __attribute__((ext_vector_type(8)));

    static ints ahead() { return ints{0, 1, 2, 3, 4, 5, 6, 7}; }
    static floats none() { return floats(0.0f); }
    static unsigned bits(ints lanes) {  // of a mask: bit n is lane n
        typedef bool bools __attribute__((ext_vector_type(8)));
        const bools each = __builtin_convertvector(lanes, bools);
        unsigned char result;
        memcpy(&result, &each, sizeof(result));
        return result;
    }
    static float sum(floats v) { return v[0] + v[1] + v[2] + v[3] + (v[4] + v[5] + v[6] + v[7]); }

    static void load(const float* from, floats* to) {
        floats u, v, w;
        memcpy(&u, from, sizeof(u)), memcpy(&v, from + 8, sizeof(v)), memcpy(&w, from + 16, sizeof(w));
        const floats a = __builtin_shufflevector(u, v, 0, 3, 6, 9, 12, 15, -1, -1);
        const floats b = __builtin_shufflevector(u, v, 1, 4, 7, 10, 13, -1, -1, -1);
        const floats c = __builtin_shufflevector(u, v, 2, 5, 8, 11, 14, -1, -1, -1);
        to[0] = __builtin_shufflevector(a, w, 0, 1, 2, 3, 4, 5, 10, 13);
        to[1] = __builtin_shufflevector(b, w, 0, 1, 2, 3, 4, 8, 11, 14);
        to[2] = __builtin_shufflevector(c, w, 0, 1, 2, 3, 4, 9, 12, 15);
    }
    static void store(float* to, floats a, floats b, floats c) {
        floats u = __builtin_shufflevector(a, b, 0, 8, -1, 1, 9, -1, 2, 10);
        floats v = __builtin_shufflevector(a, b, -1, 3, 11, -1, 4, 12, -1, 5);
        floats w = __builtin_shufflevector(a, b, 13, -1, 6, 14, -1, 7, 15, -1);
        u = __builtin_shufflevector(u, c, 0, 1, 8, 3, 4, 9, 6, 7);
        v = __builtin_shufflevector(v, c, 10, 1, 2, 11, 4, 5, 12, 7);
        w = __builtin_shufflevector(w, c, 0, 13, 2, 3, 14, 5, 6, 15);
        memcpy(to, &u, sizeof(u)), memcpy(to + 8, &v, sizeof(v)), memcpy(to + 16, &w, sizeof(w));
    }
};
#endif
"""


def fill(code: str, **parts: str) -> str:
    """Replace the words that stand alone in C++ code by statements."""
    return re.sub(r"\b(" + "|".join(parts) + r")\b", lambda found: parts[found[0]], code)
