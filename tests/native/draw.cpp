// Drawing of known triangles, as the CPU does it and as CUDA does it, in images of less and more than eight columns.
#include <vector>

#include "check.h"
#include "coverage.h"
#include "draw.h"

using namespace nr;

constexpr float NEAR = 0.5f, FAR = 10.0f;

// Faces and their images. Vectors of the exact size let the sanitizer see each access beside them.
struct Image {
    int height, width, perspective = 1, two_sided = 0, bands = 1;
    std::vector<vec3> corners;
    std::vector<int> shown, visible;
    std::vector<float> depth;

    void add(vec3 a, vec3 b, vec3 c) { corners.insert(corners.end(), {a, b, c}); }
    int count() const { return (int)corners.size() / 3; }
    int at(int i, int j) const { return shown[(height - 1 - j) * width + i]; }
    float depth_at(int i, int j) const { return depth[(height - 1 - j) * width + i]; }

    Drawing call() {
        shown.assign(height * width, -2), depth.assign(height * width, -1.0f), visible.assign(count() + 1, 0);
        Drawing call = {};
        call.faces = corners.data(), call.images = 1, call.count = count(), call.height = height, call.width = width;
        call.near = NEAR, call.far = FAR, call.two_sided = two_sided, call.perspective = perspective;
        call.bands = bands, call.nearest = depth.data(), call.face_index = shown.data(), call.visible = visible.data();
        return call;
    }
    Image& draw() {
        const Drawing own = call();
        for (int task = 0; task < bands; ++task) draw_band(own, task);
        return *this;
    }
    // Draw what lies behind the depths of an image.
    Image& peel(const Image& before) {
        Drawing own = call();
        own.behind = before.depth.data();
        for (int task = 0; task < bands; ++task) peel_band(own, task);
        return *this;
    }
    // Draw by keys and a queue of large faces, whose work ``threads`` share.
    Image& draw_by_keys(int threads) {
        Drawing own = call();
        std::vector<int64> keys(height * width, NO_FACE), entries(2 * count());
        int64 total = 0;
        own.keys = keys.data(), own.queue = {entries.data(), &total, threads}, own.each = 1;
        for (int task = 0; task < count(); ++task) draw_or_queue_face(own, task);
        for (int task = 0; task < threads; ++task) draw_queued_faces(own, task);
        for (int task = 0; task < height; ++task) decode_keys(own, task);
        return *this;
    }
};

// The lower left half of the image, without the pixels whose centres lie on its border; counter-clockwise.
void add_half(Image& image, float z) {
    const float edge = 1.0f - 1.0f / (float)image.width;
    image.add({-1.0f, -1.0f, z}, {edge, -1.0f, z}, {-1.0f, edge, z});
}

// A square image shows the half below its diagonal, at the depth of the face; row 0 of the memory is at the top.
void test_half(int size, int bands, int perspective) {
    Image image = {size, size, perspective, 0, bands, {}, {}, {}, {}};
    add_half(image, 2.0f);
    image.draw();
    for (int j = 0; j < size; ++j)
        for (int i = 0; i < size; ++i) {
            const bool inside = i + j < size - 1;
            CHECK(image.at(i, j) == (inside ? 0 : -1));
            CHECK(fabsf(image.depth_at(i, j) - (inside ? 2.0f : FAR)) < 1e-6f);
        }
    CHECK(image.visible[0] == (size > 1) && image.visible[1] == 1);
}

// The nearest face wins; at equal depth the first; behind the near plane and before the far plane, facing the camera.
void test_order() {
    Image image = {9, 9, 1, 0, 1, {}, {}, {}, {}};
    for (float z : {3.0f, 2.0f, 2.0f, 0.4f, 11.0f, -1.0f, NAN}) add_half(image, z);
    std::vector<vec3>& v = image.corners;
    image.add(v[2], v[1], {-1.0f, -1.0f, 1.0f});
    CHECK(image.draw().at(0, 0) == 1);
    CHECK(image.visible[1] == 1 && image.visible[0] == 0 && image.visible[2] == 0 && image.visible[8] == 1);
    image.two_sided = 1;
    CHECK(image.draw().at(0, 0) == 7);
}

// At equal depth any front wins over a back, as if the backs were further faces after all others.
void test_ties(int width) {
    Image image = {9, width, 1, 1, 1, {}, {}, {}, {}};
    add_half(image, 2.0f);
    const vec3 front[3] = {image.corners[0], image.corners[1], image.corners[2]};
    image.corners.clear();
    image.add(front[2], front[1], front[0]);
    image.add(front[0], front[1], front[2]);
    CHECK(image.draw().at(0, 0) == 1);
    CHECK(image.draw_by_keys(3).at(0, 0) == 1);
}

// Each layer shows the next face behind the one before; ties are not shown again.
void test_layers() {
    Image first = {12, 12, 1, 0, 2, {}, {}, {}, {}};
    for (float z : {3.0f, 2.0f, 2.0f}) add_half(first, z);
    Image second = first, third = first;
    CHECK(first.draw().at(0, 0) == 1);
    CHECK(second.peel(first).at(0, 0) == 0 && fabsf(second.depth_at(0, 0) - 3.0f) < 1e-6f && second.at(11, 11) == -1);
    CHECK(third.peel(second).at(0, 0) == -1);
}

// A triangle from near to far: depth is linear in perspective for 1 / z, else for z.
void test_depth() {
    for (int perspective : {0, 1}) {
        Image image = {8, 8, perspective, 0, 1, {}, {}, {}, {}};
        image.add({-1.0f, -1.0f, 1.0f}, {1.0f, -1.0f, 4.0f}, {-1.0f, 1.0f, 1.0f});
        image.draw();
        for (int i = 0; i < 8; ++i) {
            const float share = ((float)i + 0.5f) / 8.0f;
            const float z = perspective ? 1.0f / (1.0f - 0.75f * share) : 1.0f + 3.0f * share;
            CHECK(fabsf(image.depth_at(i, 0) - z) < 1e-5f);
        }
    }
}

// Faces of all kinds, by a simple generator of random numbers.
Image mixture(int height, int width) {
    Image image = {height, width, 1, 1, 3, {}, {}, {}, {}};
    unsigned state = 1;
    const auto random = [&state](float low, float high) {
        state = state * 1664525u + 1013904223u;
        return low + (high - low) * (float)(state >> 8) / 16777216.0f;
    };
    for (int f = 0; f < 60; ++f) {
        const float size = f % 3 ? 0.2f : 2.0f, x = random(-1.2f, 1.2f), y = random(-1.2f, 1.2f);
        vec3 v[3];
        for (vec3& corner : v)
            corner = {x + random(-size, size), y + random(-size, size), random(f % 10 ? 0.4f : -2.0f, 11.0f)};
        image.add(v[0], v[1], v[2]);
    }
    image.add({NAN, 0.0f, 1.0f}, {1.0f, 0.0f, 1.0f}, {0.0f, 1.0f, 1.0f});
    image.add({-1e12f, -1e12f, 9.0f}, {1e12f, -1e12f, 9.0f}, {0.0f, 1e12f, 9.0f});
    image.add({0.0f, 0.0f, 0.0f}, {1.0f, 0.0f, 1.0f}, {0.0f, 1.0f, 1.0f});
    image.add({0.1f, 0.1f, 1.0f}, {0.1f, 0.1f, 1.0f}, {0.1f, 0.1f, 1.0f});
    return image;
}

// Bands, single floats and keys draw the same faces.
void test_ways(int height, int width) {
    const Image faces = mixture(height, width);
    Image whole = faces, keys = faces;
    whole.bands = 1;
    whole.draw();
    for (int bands : {2, 3, height}) {
        Image image = faces;
        image.bands = bands;
        CHECK(image.draw().shown == whole.shown && image.depth == whole.depth && image.visible == whole.visible);
    }
    for (int threads : {1, 7, 1000})
        CHECK(keys.draw_by_keys(threads).shown == whole.shown && keys.visible == whole.visible);
}

int main() {
    for (int size : {2, 7, 8, 9, 16, 31})
        for (int bands : {1, 2})
            for (int perspective : {0, 1}) test_half(size, bands, perspective);
    test_order();
    for (int width : {5, 9}) test_ties(width);
    test_layers();
    test_depth();
    for (int width : {1, 5, 8, 13, 40}) test_ways(17, width);
    return failures != 0;
}
