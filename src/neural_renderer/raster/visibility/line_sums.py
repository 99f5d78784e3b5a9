"""Sums along stored scan lines, for the estimator "nmr", in plain C++.

The loops are plain C++ over memory, because that is what compilers turn into vector instructions; Warp's own vectors
come out scalar.
"""

# For each pixel of a scan line: the decrease of the loss if the edge moved there, divided by the travel of a corner,
# which is reach * distance + slack. The pixels are summed for both corners, and multiplied by each corner's share.
# Operands may be fused as in `_COPY`: an exact zero stays one.
SCAN_LINE = """
struct ScanLine {
    #if defined(__CUDA_ARCH__)
    typedef float floats;
    enum { AT_ONCE = 1 };
    int lane, lanes;  // neighbouring threads take neighbouring pixels
    static CUDA_CALLABLE floats load(const float* from) { return *from; }
    static CUDA_CALLABLE floats ahead() { return 0.0f; }
    static CUDA_CALLABLE float total(floats v) { return v; }
    #else
    typedef float floats __attribute__((ext_vector_type(16)));
    typedef int ints __attribute__((ext_vector_type(16)));
    enum { AT_ONCE = 16, FEW = 8, lane = 0, lanes = 1 };
    static floats load(const float* from) {
        floats all;
        memcpy(&all, from, sizeof(all));
        return all;
    }
    static floats ahead() {
        return floats{0.f, 1.f, 2.f, 3.f, 4.f, 5.f, 6.f, 7.f, 8.f, 9.f, 10.f, 11.f, 12.f, 13.f, 14.f, 15.f};
    }
    static float total(floats v) {
        const auto eight = v.lo + v.hi;
        const auto four = eight.lo + eight.hi;
        return four[0] + four[2] + (four[1] + four[3]);
    }
    #endif
    const float* stored;  // the line's first pixel; the gradients of the channels follow, `plane` apart
    wp::int64 plane, area;  // strides from channel to channel: of stored gradients, of colours
    int channels;  // 0 if the gains themselves are stored
    const float* color;  // the first channel's
    float reach, share_p, share_q, slack_p, slack_q;
    floats to_p, to_q;  // sums, as vectors
    float also_to_p, also_to_q;  // sums of single pixels

    // The usual three channels are spelled out, so that their colours stay in registers.
    CUDA_CALLABLE floats loss(const float* pull, float red, float green, float blue) const {
        #pragma clang fp contract(fast)
        floats lost = red * load(pull);
        if (channels >= 3) {
            lost += green * load(pull + plane);
            lost += blue * load(pull + 2 * plane);
        }
        for (int c = channels < 3 ? 1 : 3; c < channels; ++c) lost += color[c * area] * load(pull + c * plane);
        return lost;
    }

    // `count` pixels from `begin` on, in direction `way`; `distance` is from the edge to the first. Values stored after
    // them must be 0.
    CUDA_CALLABLE void outward(int begin, int way, int count, float distance) {
        #pragma clang fp contract(fast)
        const float red = color[0], green = channels < 3 ? 0.0f : color[area];
        const float blue = channels < 3 ? 0.0f : color[2 * area];
        const floats none = 0.0f, start = distance + (way > 0 ? ahead() : (float)(AT_ONCE - 1) - ahead());
        const float* at = stored + begin - (way > 0 ? 0 : AT_ONCE - 1) + way * lane;
        floats sum_p = none, sum_q = none;
        for (int n = lane; n < count; n += AT_ONCE * lanes, at += way * AT_ONCE * lanes) {
            floats gain = load(at);
            if (channels > 0) gain -= loss(at + plane, red, green, blue);
            ADD
        }
        to_p += share_p * sum_p, to_q += share_q * sum_q;
    }

    // Inward: only over pixels that show the face f, by the face numbers from ``shown`` on, ``step`` apart.
    CUDA_CALLABLE void inward(int begin, int way, int count, float distance, int f, const int* shown, int step) {
        #pragma clang fp contract(fast)
        #if !defined(__CUDA_ARCH__)
        if (count > FEW) return inward_by_many(begin, way, count, distance, f, shown, step);
        #endif
        float sum_p = 0.0f, sum_q = 0.0f;
        const float* at = stored + begin + way * lane;
        shown += step * lane;
        for (int n = lane; n < count; n += lanes, at += way * lanes, shown += step * lanes) {
            if (*shown != f) continue;
            float gain = channels > 0 ? at[0] : -at[0];
            if (channels > 0) {
                float lost = color[0] * at[plane];
                for (int c = 1; c < channels; ++c) lost += color[c * area] * at[(c + 1) * plane];
                gain -= lost;
            }
            typedef float floats;
            const float start = distance, none = 0.0f;
            ADD
        }
        also_to_p += share_p * sum_p, also_to_q += share_q * sum_q;
    }

    #if !defined(__CUDA_ARCH__)
    void inward_by_many(int begin, int way, int count, float distance, int f, const int* shown, int step) {
        #pragma clang fp contract(fast)
        const float red = color[0], green = channels < 3 ? 0.0f : color[area];
        const float blue = channels < 3 ? 0.0f : color[2 * area];
        const floats none = 0.0f, start = distance + (way > 0 ? ahead() : (float)(AT_ONCE - 1) - ahead());
        const float* at = stored + begin - (way > 0 ? 0 : AT_ONCE - 1);
        floats sum_p = none, sum_q = none;
        for (int n = 0; n < count; n += AT_ONCE, at += way * AT_ONCE) {
            ints here;
            for (int k = 0; k < AT_ONCE; ++k) {
                const int away = way > 0 ? n + k : n + AT_ONCE - 1 - k;
                here[k] = away < count && shown[away < count ? away * step : 0] == f ? -1 : 0;
            }
            floats gain = channels > 0 ? load(at) - loss(at + plane, red, green, blue) : -load(at);
            gain = here ? gain : none;
            ADD
        }
        to_p += share_p * sum_p, to_q += share_q * sum_q;
    }
    #endif
};
""".replace(
    "ADD",
    """const floats away = start + (float)n;
            const floats travel_p = reach * away + slack_p, travel_q = reach * away + slack_q;
            const floats part = (gain > 0.0f ? gain : none) / (travel_p * travel_q);
            sum_p += part * travel_q, sum_q += part * travel_p;""",
)
