/* A CUDA device on a processor: registers, conversions, atomics, and a launch that runs threads one after another.
 *
 * Compiled with -DRACES it records for every byte of global memory which threads read, wrote or added to it, and counts
 * accesses that are not ordered. Compiled with -DCOUNTS it counts memory operations. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef union {
    int8_t s8; int16_t s16; int32_t s32; int64_t s64;
    uint8_t u8; uint16_t u16; uint32_t u32; uint64_t u64;
    float f32; double f64; int pred;
} Register;

typedef struct { uint32_t x, block, block_size, blocks; } Thread;
typedef void (*Function)(char** parameters, Thread thread);
Function find(const char* name);

static inline float as_f32(uint64_t bits) { Register r; r.u64 = bits; return r.f32; }
static inline double as_f64(uint64_t bits) { Register r; r.u64 = bits; return r.f64; }
static inline double saturate(double x) { return x > 0 ? (x < 1 ? x : 1) : 0; }

/* Conversions of CUDA: NaN is 0, and numbers out of range become the nearest one. */
#define CONVERSION(name, type, low, high) \
    static inline type to_##name(double x) { return isnan(x) ? 0 : x <= (double)(low) ? (low) : x >= (double)(high) ? (high) : (type)x; }
CONVERSION(s8, int8_t, INT8_MIN, INT8_MAX)
CONVERSION(u8, uint8_t, 0, UINT8_MAX)
CONVERSION(s16, int16_t, INT16_MIN, INT16_MAX)
CONVERSION(u16, uint16_t, 0, UINT16_MAX)
CONVERSION(s32, int32_t, INT32_MIN, INT32_MAX)
CONVERSION(u32, uint32_t, 0, UINT32_MAX)
CONVERSION(s64, int64_t, INT64_MIN, INT64_MAX)
CONVERSION(u64, uint64_t, 0, UINT64_MAX)

/* Threads run one after another, so plain operations are atomic. Each returns the old value. */
#define ATOMIC_TYPE(name, type) \
    static inline type atomic_add_##name(char* at, type value) { type old = *(type*)at; *(type*)at = old + value; return old; } \
    static inline type atomic_min_##name(char* at, type value) { type old = *(type*)at; if (value < old) *(type*)at = value; return old; } \
    static inline type atomic_max_##name(char* at, type value) { type old = *(type*)at; if (value > old) *(type*)at = value; return old; } \
    static inline type atomic_exch_##name(char* at, type value) { type old = *(type*)at; *(type*)at = value; return old; } \
    static inline type atomic_cas_##name(char* at, type expected, type value) { type old = *(type*)at; if (old == expected) *(type*)at = value; return old; }
ATOMIC_TYPE(f32, float)
ATOMIC_TYPE(f64, double)
ATOMIC_TYPE(s32, int32_t)
ATOMIC_TYPE(u32, uint32_t)
ATOMIC_TYPE(s64, int64_t)
ATOMIC_TYPE(u64, uint64_t)
static inline uint32_t atomic_or_u32(char* at, uint32_t value) { uint32_t old = *(uint32_t*)at; *(uint32_t*)at = old | value; return old; }
static inline uint32_t atomic_and_u32(char* at, uint32_t value) { uint32_t old = *(uint32_t*)at; *(uint32_t*)at = old & value; return old; }

#if defined(RACES) || defined(COUNTS)
/* A hash table from places in memory to what the launch has done there. It outlives the launch: cells of earlier ones
 * are known by their number, and used again. */
typedef struct { uint64_t place, launch; int64_t writer, reader, adder; } Cell;
static Cell* cells;
static uint64_t capacity, used, launch;
static int64_t self;
static char *stack_low, *stack_high;

static Cell* cell_of(uint64_t place) {
    if (2 * (used + 1) > capacity) {
        Cell* old = cells;
        const uint64_t count = capacity;
        capacity = count ? 2 * count : 1 << 16;
        cells = calloc(capacity, sizeof(Cell));
        used = 0;
        for (uint64_t i = 0; i < count; ++i) if (old[i].launch == launch) *cell_of(old[i].place) = old[i];
        free(old);
    }
    uint64_t slot = (place * 0x9E3779B97F4A7C15ull >> 20) & (capacity - 1);
    while (cells[slot].launch == launch && cells[slot].place != place) slot = (slot + 1) & (capacity - 1);
    if (cells[slot].launch != launch) { cells[slot] = (Cell){.place = place, .launch = launch}; ++used; }
    return cells + slot;
}

static int on_stack(const char* at) { return at >= stack_low && at < stack_high; }
#endif

#if defined(RACES)
/* Threads are numbered from 1. What holds single bytes holds nothing else, so a place is a byte or four of them. */
enum { MANY = -1 };
static int64_t races, stale, sums;
static int other(int64_t thread) { return thread && thread != self; }
static uint64_t place_of(const char* at, int size) { return size < 4 ? (uint64_t)at << 1 | 1 : (uint64_t)at >> 2 << 1; }
#define EACH_PLACE(at, size) \
    if (on_stack(at)) return; \
    for (int i = 0, step = (size) < 4 ? 1 : 4; i < (size); i += step)

static void note_read(char* at, int size) {
    EACH_PLACE(at, size) {
        Cell* cell = cell_of(place_of(at + i, size));
        races += i == 0 && other(cell->writer);
        stale += i == 0 && other(cell->adder);
        cell->reader = other(cell->reader) ? MANY : self;
    }
}

/* Several threads may store one value at one place: the result does not depend on their order. */
static void note_write(char* at, int size, const void* value) {
    const int same = !memcmp(at, value, size);
    EACH_PLACE(at, size) {
        Cell* cell = cell_of(place_of(at + i, size));
        races += i == 0 && ((other(cell->writer) && !same) || other(cell->reader) || other(cell->adder));
        cell->writer = self;
    }
}

static void note_atomic(char* at, int size, int is_sum) {
    EACH_PLACE(at, size) {
        Cell* cell = cell_of(place_of(at + i, size));
        races += i == 0 && other(cell->writer);
        stale += i == 0 && other(cell->reader);
        sums += i == 0 && is_sum && other(cell->adder);
        cell->adder = self;
    }
}
#define READ(at, size) note_read(at, size)
#define WRITE(at, size, value) note_write(at, size, value)
#define ATOMIC(at, size, is_sum) note_atomic(at, size, is_sum)
#elif defined(COUNTS)
/* Memory is read and written in sectors. `self` numbers warps from 1: a warp moves a sector once, and so does the
 * launch between its cache and the memory. */
enum { SECTOR = 32 };
static int64_t operations, moved, touched;

static void note(char* at, int size) {
    ++operations;
    if (on_stack(at)) return;
    for (uint64_t place = (uint64_t)at / SECTOR; place <= ((uint64_t)at + size - 1) / SECTOR; ++place) {
        Cell* cell = cell_of(place);
        touched += cell->reader == 0;
        moved += cell->reader != self;
        cell->reader = self;
    }
}
#define READ(at, size) note(at, size)
#define WRITE(at, size, value) note(at, size)
#define ATOMIC(at, size, is_sum) note(at, size)
#else
#define READ(at, size)
#define WRITE(at, size, value)
#define ATOMIC(at, size, is_sum)
#endif

enum { BLOCK = 256, WARP = 32 };

/* Run one launch of `count` threads, rounded up to whole blocks, in steps of `stride` through their numbers.
 *
 * result: -DRACES: [0] plain accesses of which one is a write and which are not ordered, [1] plain reads beside atomics:
 * they see an old value, which is right where it only saves an atomic minimum, [2] additions of floats to the sums of
 * other threads, which round in any order. -DCOUNTS: [0] memory operations, [1] those
 * of the longest thread, [2] the sum over warps of their longest thread, [3] threads with any, [4] all threads, [5] bytes
 * of all sectors that warps move, each counted once a warp, [6] bytes of all sectors, each counted once.
 * Returns 0, or 1 for an unknown kernel. */
int run(const char* name, char** parameters, uint64_t count, uint64_t stride, int64_t* result) {
    const Function kernel = find(name);
    if (!kernel) return 1;
    const uint64_t padded = (count + BLOCK - 1) / BLOCK * BLOCK;
#if defined(RACES) || defined(COUNTS)
    char here;
    stack_high = &here + 4096;
    stack_low = &here - (1 << 20);
    used = 0;
    ++launch;
#endif
#if defined(RACES)
    races = stale = sums = 0;
#elif defined(COUNTS)
    moved = touched = 0;
    int64_t longest = 0;
    stride = 1; /* whole warps, one after another */
#endif
    for (uint64_t i = 0; i < padded; ++i) {
        const uint64_t number = (uint64_t)((unsigned __int128)i * stride % padded);
        const Thread thread = {number % BLOCK, number / BLOCK, BLOCK, padded / BLOCK};
#if defined(RACES)
        self = (int64_t)number + 1;
#elif defined(COUNTS)
        operations = 0;
        self = (int64_t)(number / WARP) + 1;
#endif
        kernel(parameters, thread);
#if defined(COUNTS)
        result[0] += operations;
        if (operations > result[1]) result[1] = operations;
        longest = number % WARP == 0 || operations > longest ? operations : longest;
        if (number % WARP == WARP - 1) result[2] += longest;
        result[3] += operations > 0;
#endif
    }
#if defined(COUNTS)
    result[4] = count;
    result[5] = SECTOR * moved;
    result[6] = SECTOR * touched;
#endif
#if defined(RACES)
    result[0] = races;
    result[1] = stale;
    result[2] = sums;
#endif
    return 0;
}
