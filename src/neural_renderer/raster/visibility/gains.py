"""Gains: the change of the loss if a visible boundary moves outward by a pixel where a scan line crosses it.

``GAINS`` declares a C++ struct for native functions, after `CROSSINGS`.
"""

GAINS = """
// The colour on one side of a boundary, blended from two pixels: places in memory, and weights.
struct Blend {
    wp::int64 near, next;
    float near_weight, next_weight;

    CUDA_CALLABLE float of(const Lines& lines, const float* channel) const {
        return near_weight * lines.value(channel, near) + next_weight * lines.value(channel, next);
    }
    // Extrapolate to the boundary, at a distance of ``offset`` pixels from the near centre, if both pixels show one
    // face, so that the colour is ``linear``. Otherwise take the near pixel's colour.
    CUDA_CALLABLE void extrapolate(float weight, float offset, bool linear) {
        near_weight = linear ? weight * (1.0f + offset) : weight;
        next_weight = linear ? -weight * offset : 0.0f;
    }
};

struct Gain {
    Blend inside, outside;
    bool before_is_inside, behind_is_outside;  // whether the next pixels show the faces of the near ones

    // Start with the two pixels beside a crossing, and the ones next to them.
    CUDA_CALLABLE void set(const Lines& lines, const Edge& edge, const Crossing& at) {
        const int before = at.inner - edge.outward, behind = at.outer + edge.outward, last = lines.length - 1;
        before_is_inside = lines.face(at.u, before) == at.inner_face;
        behind_is_outside = lines.face(at.u, behind) == at.outer_face;
        inside.near = lines.pixel(at.u, at.inner), outside.near = lines.pixel(at.u, at.outer);
        inside.next = lines.pixel(at.u, before < 0 ? 0 : before > last ? last : before);
        outside.next = lines.pixel(at.u, behind < 0 ? 0 : behind > last ? last : behind);
    }
    // Sum (inside - outside) * gradient over the channels, with the gradient of the pixel that contains the boundary.
    // If a side is ``narrow``, a visible centre may lie anywhere in it; then it is interpolated between both pixels.
    CUDA_CALLABLE float sum(const Lines& lines, const Crossing& at, bool narrow) const {
        const float share = narrow ? at.offset : at.offset < 0.5f ? 0.0f : 1.0f;
        const wp::int64 inner = lines.pull(at.u, at.inner), outer = lines.pull(at.u, at.outer);
        const float *channel = lines.image, *pull = lines.grad;
        float result = 0.0f;
        for (int c = 0; c < lines.channels; ++c, channel += lines.area, pull += lines.grad_area) {
            const float difference = inside.of(lines, channel) - outside.of(lines, channel);
            result += difference * ((1.0f - share) * pull[inner] + share * pull[outer]);
        }
        return result;
    }
};
"""
