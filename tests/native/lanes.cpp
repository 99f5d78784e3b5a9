// Vectors of 8 and 16 lanes give what single floats give, to the bit.
#include "check.h"
#include "lanes.h"

using namespace nr;

// Both zeros, the smallest and the largest numbers, infinities, NaN, and numbers that round.
constexpr float NUMBERS[] = {0.0f,  -0.0f,  1.0f, -1.0f, 0.1f,     -0.3f,     1e-45f,   -1e-38f,
                             3e38f, -3e38f, 7.5f, -2.5f, INFINITY, -INFINITY, NAN,      1e7f,
                             3.0f,  -1e-9f, 0.7f, 1.0f,  -7.0f,    5e-7f,     123.456f, -0.9999f,
                             1e20f, -1e20f, 2.0f, -0.5f, 16.0f,    1e-3f,     -1e3f,    8388609.0f};
constexpr int COUNT = sizeof(NUMBERS) / sizeof(*NUMBERS);

bool same(float a, float b) { return (a != a && b != b) || bits_of(a) == bits_of(b); }

// A number in each lane; `all` makes 0 of -0.
template <class F>
F filled(float value) {
    F result;
    for (int n = 0; n < Lanes<F>::WIDTH; ++n) result[n] = value;
    return result;
}

// Check a formula of two vectors, one of which has the same number in each lane.
template <class F, class Formula>
void check_formula(Formula formula, const char* text) {
    for (float b : NUMBERS)
        for (int first = 0; first + Lanes<F>::WIDTH <= COUNT; ++first) {
            const F a = load<F>(NUMBERS + first), left = formula(a, filled<F>(b)), right = formula(filled<F>(b), a);
            for (int n = 0; n < Lanes<F>::WIDTH; ++n) {
                check(same(left[n], formula(NUMBERS[first + n], b)), text, __FILE__, __LINE__);
                check(same(right[n], formula(b, NUMBERS[first + n])), text, __FILE__, __LINE__);
            }
        }
}
#define CHECK_FORMULA(formula) check_formula<F>([](auto a, auto b) { return formula; }, #formula " in all lanes")
#define CHECK_MASK(mask) CHECK_FORMULA(select(mask, a, b + 1.0f))

template <class F>
void test_operators() {
    CHECK_FORMULA(a + b);
    CHECK_FORMULA(a - b);
    CHECK_FORMULA(a * b);
    CHECK_FORMULA(a / b);
    CHECK_FORMULA(-a + 0.0f * b);
    CHECK_FORMULA(2.0f * a - b / 3.0f);
    CHECK_MASK(a < b);
    CHECK_MASK(a <= b);
    CHECK_MASK(a > b);
    CHECK_MASK(a >= b);
    CHECK_MASK(a == b);
    CHECK_MASK(a != b);
    CHECK_MASK((a < b) & (a > 0.0f));
    CHECK_MASK((a < b) | (b > 0.0f));
    CHECK_FORMULA(all<decltype(a + b)>(0.3f) + b * 0.0f);
}

template <class F>
void test_whole_numbers() {
    typedef typename Lanes<F>::Ints Ints;
    const Ints numbers = lane_numbers<Ints>();
    const F floats = to_floats(numbers * 16777 - 5);
    for (int n = 0; n < Lanes<F>::WIDTH; ++n) {
        CHECK(numbers[n] == n);
        CHECK(floats[n] == to_floats(n * 16777 - 5));
        CHECK(all<Ints>(7)[n] == 7);
    }
}

template <class F>
void test_memory() {
    float target[COUNT];
    for (int first = 0; first + Lanes<F>::WIDTH <= COUNT; ++first) {
        for (float& each : target) each = 77.0f;
        store(target + first, load<F>(NUMBERS + first));
        for (int n = 0; n < COUNT; ++n)
            CHECK(same(target[n], n >= first && n < first + Lanes<F>::WIDTH ? NUMBERS[n] : 77.0f));
    }
}

// Masks of eight, each of the 256.
void test_masks() {
    for (unsigned wanted = 0; wanted < 256; ++wanted) {
        ints8 mask;
        for (int n = 0; n < 8; ++n) mask[n] = wanted >> n & 1 ? -1 : 0;
        CHECK(bits(mask) == wanted);
        CHECK(any(mask) == (wanted != 0));
        const ints8 chosen = select(mask, all<ints8>(3), lane_numbers<ints8>());
        for (int n = 0; n < 8; ++n) CHECK(chosen[n] == (mask[n] ? 3 : n));
    }
}

void test_smaller() {
    const ints8 a = {0, 5, -7, 0x7fffffff, -0x7fffffff - 1, 2, 2, -1}, b = {1, 5, -8, 0, 0, -2, 3, 0x7fffffff};
    const ints8 found = smaller(a, b);
    for (int n = 0; n < 8; ++n) CHECK(found[n] == min(a[n], b[n]));
}

void test_sum() {
    const floats8 v = {1.0f, 2.0f, 4.0f, 8.0f, 16.0f, 32.0f, 64.0f, 128.0f};
    CHECK(sum(v) == 255.0f);
}

// Eight pixels of three channels, from memory and back, and nothing beside them.
void test_channels() {
    vec3 pixels[10], copy[10];
    for (int n = 0; n < 10; ++n)
        for (int c = 0; c < 3; ++c) pixels[n][c] = (float)(10 * n + c), copy[n][c] = -1.0f;
    floats8 channels[3];
    load(pixels + 1, channels);
    for (int n = 0; n < 8; ++n)
        for (int c = 0; c < 3; ++c) CHECK(channels[c][n] == pixels[n + 1][c]);
    store(copy + 1, channels[0], channels[1], channels[2]);
    for (int n = 0; n < 10; ++n)
        for (int c = 0; c < 3; ++c) CHECK(copy[n][c] == (n == 0 || n == 9 ? -1.0f : pixels[n][c]));
}

template <class F>
void test_all() {
    test_operators<F>();
    test_whole_numbers<F>();
    test_memory<F>();
}

int main() {
    test_all<floats8>();
    test_all<floats16>();
    test_masks();
    test_smaller();
    test_sum();
    test_channels();
    return failures != 0;
}
