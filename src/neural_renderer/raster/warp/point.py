"""The point of a face that a pixel shows, in plain C++: one source for every kernel that needs its weights.

``FACE`` declares a struct inside of a native function. ``set`` takes the corners of a face; ``at`` gives a pixel's depth
and weights; ``gather``, ``pull`` and ``give`` send the gradients of weights and depths to the corners.
"""

from .geometry import HOMOGENEOUS, IN_FRONT, NARROWEST

# Of the square of a face's largest coordinate c, in pixels: in less area nothing is known of the weights by the inverse
# matrix. They are made of products of up to 2 c^2, and all roundings together come to some 82 * 2^-24 c^2.
LEAST_AREA = 2.0**-17

FACE = f"""
struct Face {{
    typedef wp::vec_t<3, float> vec3;
    vec3 v[3];
    float matrix[9], inverse[3], dx[3], dy[3], to[9];
    int front, perspective, height, width;

    static CUDA_CALLABLE float larger(float a, float b) {{ return a > b ? a : b; }}
    static CUDA_CALLABLE int in_front(vec3 v0, vec3 v1, vec3 v2, int perspective) {{ {IN_FRONT} }}
    static CUDA_CALLABLE wp::vec_t<3, double> homogeneous(vec3 v0, vec3 v1, vec3 v2, float x, float y) {{ {HOMOGENEOUS} }}

    // The matrix takes a pixel (column, row from the bottom, 1) to its weights; 0 where the edge functions must do.
    // Weights by this inverse are how the first packages computed them: for faces far smaller than a pixel its rounding
    // (some 1e-4 of a weight) is what existing results contain.
    CUDA_CALLABLE void set(const vec3* corners, int in_perspective, int rows, int columns) {{
        perspective = in_perspective, height = rows, width = columns;
        float x[3], y[3], far = 0.0f;
        for (int k = 0; k < 3; ++k) {{
            v[k] = corners[k];
            x[k] = 0.5f * ((float)width * v[k][0] + (float)(width - 1));
            y[k] = 0.5f * ((float)height * v[k][1] + (float)(height - 1));
            far = larger(far, larger(fabsf(x[k]), fabsf(y[k])));
            inverse[k] = perspective ? 1.0f / v[k][2] : 1.0f;
        }}
        front = in_front(v[0], v[1], v[2], perspective);
        const float area = x[2] * (y[0] - y[1]) + x[0] * (y[1] - y[2]) + x[1] * (y[2] - y[0]);
        const bool known = fabsf(area) > {LEAST_AREA!r}f * far * far;
        for (int k = 0; k < 3; ++k) {{
            const int m = (k + 1) % 3, n = (k + 2) % 3;
            matrix[3 * k] = known ? (y[m] - y[n]) / area : 0.0f;
            matrix[3 * k + 1] = known ? (x[n] - x[m]) / area : 0.0f;
            matrix[3 * k + 2] = known ? (x[m] * y[n] - x[n] * y[m]) / area : 0.0f;
        }}
    }}

    // Depth and weights in space of the pixel i of the row j from the bottom; those on the screen are w / whole.
    CUDA_CALLABLE float at(int i, int j, vec3& weights, vec3& w, float& whole) const {{
        const float px = (float)i, py = (float)j;
        if (front == 0) {{
            const wp::vec_t<3, double> a = homogeneous(
                v[0], v[1], v[2], (float)(2 * i + 1 - width) / (float)width, (float)(2 * j + 1 - height) / (float)height);
            const double sum = a[0] + a[1] + a[2];
            for (int k = 0; k < 3; ++k) weights[k] = (float)(a[k] / sum), w[k] = (float)(a[k] * (double)v[k][2]);
            whole = 1.0f;
            return (float)(1.0 / sum);
        }}
        for (int k = 0; k < 3; ++k) {{
            const float share = matrix[3 * k] * px + matrix[3 * k + 1] * py + matrix[3 * k + 2];
            w[k] = share < 0.0f ? 0.0f : share > 1.0f ? 1.0f : share;
        }}
        whole = w[0] + w[1] + w[2];
        if (whole == 0.0f) edge_weights(i, j, w, whole);
        if (perspective) {{
            for (int k = 0; k < 3; ++k) weights[k] = w[k] * inverse[k];
            const float near = 1.0f / (weights[0] + weights[1] + weights[2]);
            for (int k = 0; k < 3; ++k) weights[k] *= near;
            return whole * near;
        }}
        const float part = 1.0f / whole;
        for (int k = 0; k < 3; ++k) weights[k] = w[k] * part;
        return weights[0] * v[0][2] + weights[1] * v[1][2] + weights[2] * v[2][2];
    }}

    // By the edge functions of `coverage`: where it drew the face, they have one sign and are not all 0.
    CUDA_CALLABLE void edge_weights(int i, int j, vec3& w, float& whole) const {{
        const float x = (float)(2 * i + 1 - width) / (float)width, y = (float)(2 * j + 1 - height) / (float)height;
        for (int k = 0; k < 3; ++k) {{
            const vec3 &a = v[(k + 1) % 3], &b = v[(k + 2) % 3];
            w[k] = (a[0] - x) * (b[1] - y) - (a[1] - y) * (b[0] - x);
        }}
        whole = w[0] + w[1] + w[2];
        if (whole == 0.0f) w = vec3(1.0f, 1.0f, 1.0f), whole = 3.0f;
    }}

    // Begin to gather, with what the weights on the screen gain per step to the right and up. Where one would change by 1
    // over less than four roundings of a coordinate near 1, nothing is known of that.
    CUDA_CALLABLE void gather() {{
        const float area = (v[1][0] - v[0][0]) * (v[2][1] - v[0][1]) - (v[1][1] - v[0][1]) * (v[2][0] - v[0][0]);
        float longest = 0.0f;
        for (int k = 0; k < 3; ++k) {{
            const vec3 &a = v[(k + 1) % 3], &b = v[(k + 2) % 3];
            dx[k] = a[1] - b[1], dy[k] = b[0] - a[0];
            longest = larger(longest, larger(fabsf(dx[k]), fabsf(dy[k])));
        }}
        const bool known = fabsf(area) > {NARROWEST!r}f * longest;
        for (int k = 0; k < 3; ++k) dx[k] = known ? dx[k] / area : 0.0f, dy[k] = known ? dy[k] / area : 0.0f;
        for (int k = 0; k < 9; ++k) to[k] = 0.0f;
    }}

    // With the pixel fixed, moving corner m by s on the screen changes the weight w_k there by -w_m grad(w_k) . s; in
    // perspective, depth and the weights in space are made of w_k / z_k: 1 / depth is their sum.
    CUDA_CALLABLE void pull(vec3 to_weights, float to_depth, vec3 weights, vec3 w, float whole, float z) {{
        const float part = 1.0f / whole;
        float right = 0.0f, up = 0.0f, g[3];
        const float same = wp::dot(to_weights, weights) + z * to_depth;
        for (int k = 0; k < 3; ++k) {{
            g[k] = perspective ? z * (to_weights[k] - same) * inverse[k] : to_weights[k] + to_depth * v[k][2];
            right += g[k] * dx[k], up += g[k] * dy[k];
        }}
        for (int k = 0; k < 3; ++k) {{
            const float share = w[k] * part;
            to[3 * k] -= right * share;
            to[3 * k + 1] -= up * share;
            to[3 * k + 2] += share * (perspective ? -g[k] * inverse[k] : to_depth);
        }}
    }}

    // Hand over to the face's corners what came together; ``alone`` if nobody else has a part in them.
    CUDA_CALLABLE void give(vec3* corners, bool alone) const {{
        for (int k = 0; k < 3; ++k) {{
            const vec3 part(to[3 * k], to[3 * k + 1], to[3 * k + 2]);
            if (alone) corners[k] = part;
            else wp::atomic_add(corners + k, part);
        }}
    }}
}};
"""
