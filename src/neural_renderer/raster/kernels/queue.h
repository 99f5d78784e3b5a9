// A work queue on CUDA: one launch fills it with large faces, or those that have work; the next one shares the work.
//
// Otherwise the GPU would wait for the few threads that process large triangles behind a fine mesh.
#pragma once

#include "geometry.h"

namespace nr {

struct Queue {
    int64* entries;  // [faces, 2]: number of a face, counted over all images, and index of its first thread
    int64* total;    // [1]: number of threads in the lower 36 bits, of faces in the upper ones
    int64 threads;   // threads of the launch that takes the work; 0 where there is no queue, and a task is a face

    // The power of 2 that separates the two counters in ``total``.
    static constexpr int64 FACE = (int64)1 << 36;

    // Append a face with its number of threads. One atomic counts both, so that thread indices ascend with entries.
    NR_FUNC void put(int64 face, int64 count) const {
        const int64 before = atomic_add(total, FACE + count);
        entries[2 * (before / FACE)] = face, entries[2 * (before / FACE) + 1] = before % FACE;
    }
    NR_FUNC int64 thread_count() const { return total[0] % FACE; }

    // Find the face of a thread, and the thread's index among those of the face, by binary search.
    NR_FUNC void find(int64 thread, int64& face, int64& index) const {
        int64 low = 0, high = total[0] / FACE;
        while (high - low > 1) {  // the last face that begins before
            const int64 middle = (low + high) / 2;
            if (entries[2 * middle + 1] <= thread) low = middle;
            else high = middle;
        }
        face = entries[2 * low], index = thread - entries[2 * low + 1];
    }
};

// The work of a task on a face: every ``lanes``-th pixel, starting at ``lane``, of every ``parts``-th scan line,
// starting at ``part``, among the lines [first, last).
struct LineTask {
    int image, face, lane, lanes, part, parts;
    int first = 0, last = 1 << 30;
};

// The number of threads that share the scan lines of a face, with at most ``most`` rows and columns each.
NR_FUNC int line_parts(const vec3* v, const Scene& scene, int most) {
    const Box box = pixel_box(v, 1, scene);
    return max(max(box.right - box.left, box.top - box.bottom) + most, most) / most;
}

// Append a face to the queue of `for_each_line_task`.
NR_FUNC void put_lines(const Queue& queue, const Scene& scene, int image, int face, int lanes, int most) {
    const int parts = line_parts(scene.corners(image, face), scene, most);
    queue.put((int64)image * scene.count + face, (int64)parts * lanes);
}

// Call visit(task) for the work of one task of `line_threads`: a whole face, or on CUDA entries of the queue.
template <class Visit>
NR_FUNC void for_each_line_task(const Queue& queue, const Scene& scene, int task, int lanes, int most, Visit visit) {
    if (queue.threads == 0) {
        visit(LineTask{task / scene.count, task % scene.count, 0, 1, 0, 1});
        return;
    }
    const int64 end = queue.thread_count();
    for (int64 thread = task; thread < end; thread += queue.threads) {
        int64 face, index;
        queue.find(thread, face, index);
        const int image = (int)(face / scene.count), f = (int)(face % scene.count);
        const int parts = line_parts(scene.corners(image, f), scene, most);
        visit(LineTask{image, f, (int)(index % lanes), lanes, (int)(index / lanes), parts});
    }
}

}  // namespace nr
