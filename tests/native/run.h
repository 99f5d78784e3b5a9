// Kernels as C functions, for `kernels.py`.
#pragma once

#include <thread>
#include <vector>

// Call kernel(call, task) for the tasks [first, first + count) on several threads. Which of them has a task looks
// random: with every n-th task for each, a sanitizer would never see collisions of tasks n apart.
template <class Call>
void run_tasks(void (*kernel)(const Call&, int), const Call& call, int first, int count, int threads) {
    const auto work = [&](unsigned own) {
        for (int task = first; task < first + count; ++task)
            if (((unsigned)task * 2654435769u >> 8) % (unsigned)threads == own) kernel(call, task);
    };
    std::vector<std::thread> others;
    for (int own = 1; own < threads; ++own) others.emplace_back(work, own);
    work(0);
    for (std::thread& other : others) other.join();
}

// The kernel ``name``, whose struct has ``size`` bytes in Python.
#define NR_EXPORT(name, Call, size)                                                             \
    static_assert(sizeof(nr::Call) == size, "the struct " #Call " has another size in Python"); \
    extern "C" void run_##name(const nr::Call* call, int first, int count, int threads) {       \
        run_tasks(nr::name, *call, first, count, threads);                                      \
    }
