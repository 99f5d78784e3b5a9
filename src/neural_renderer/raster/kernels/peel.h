// Depth peeling: the nearest faces behind the layer before (Everitt, "Interactive order-independent transparency",
// 2001).
#pragma once

#include "draw.h"

namespace nr {

// Drawing begins behind a depth of each pixel, that of the layer before.
struct BehindLayer {
    template <class F>
    static NR_FUNC F depth(const Drawing& call, int64 pixel) {
        return load<F>(call.behind + pixel);
    }
};

NR_FUNC void peel_band(const Drawing& call, int task) { draw_band_of_rows<BehindLayer>(call, task); }
NR_FUNC void peel_or_queue_face(const Drawing& call, int task) { draw_or_queue<BehindLayer>(call, task); }
NR_FUNC void peel_queued_faces(const Drawing& call, int task) { draw_from_queue<BehindLayer>(call, task); }

}  // namespace nr
