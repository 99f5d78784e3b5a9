// Checks of the C++ tests: a failed one is printed and counted, and the test goes on.
#pragma once

#include <stdio.h>

inline int failures = 0;

inline void check(bool passed, const char* what, const char* file, int line) {
    if (passed) return;
    ++failures;
    fprintf(stderr, "%s:%d: expected %s\n", file, line, what);
}

#define CHECK(condition) check(condition, #condition, __FILE__, __LINE__)
