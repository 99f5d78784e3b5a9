// Formulas of faces on the pixel grid, at the borders of what they allow.
#include <initializer_list>

#include "check.h"
#include "geometry.h"

using namespace nr;

constexpr float HUGE_NUMBERS[] = {NAN, INFINITY, -INFINITY, 3e38f, -3e38f, 1.1e12f};

struct Corners {
    vec3 v[3];

    Corners reversed() const { return {{v[2], v[1], v[0]}}; }
    Corners with(int corner, int axis, float value) const {
        Corners result = *this;
        result.v[corner][axis] = value;
        return result;
    }
};

// Counter-clockwise, at depth 1.
const Corners FACE = {{{-0.5f, -0.5f, 1.0f}, {0.5f, -0.5f, 1.0f}, {0.0f, 0.5f, 1.0f}}};

// Centres are the integers, up to a rounding.
void test_pixels() {
    for (int size : {1, 2, 3, 7, 64, 255, 256, 1000, 4096})
        for (int i = 0; i < size; ++i) {
            const float x = pixel_centre(i, size);
            CHECK(-1.0f < x && x < 1.0f);
            CHECK(fabsf(to_pixels(x, size) - (float)i) <= 1e-7f * (float)size);
            CHECK(pixel_centre(size - 1 - i, size) == -x);
        }
    CHECK(pixel_centre(0, 2) == -0.5f && pixel_centre(1, 2) == 0.5f);
    CHECK(to_pixels(-1.0f, 10) == -0.5f && to_pixels(1.0f, 10) == 9.5f);
}

void test_facing() {
    const Corners back = FACE.reversed(), line = FACE.with(2, 1, -0.5f);
    for (int perspective : {0, 1}) {
        CHECK(facing(FACE.v, perspective) == 1 && visible_side(FACE.v, perspective) == 0);
        CHECK(facing(back.v, perspective) == -1 && visible_side(back.v, perspective) == 1);
        CHECK(facing(line.v, perspective) == 0 && visible_side(line.v, perspective) == 0);
    }
    CHECK(doubled_area(FACE.v) == 1.0f && doubled_area(back.v) == -1.0f);
    // Each corner behind the camera reverses the orientation, in perspective alone.
    Corners face = FACE;
    for (int behind = 1; behind <= 3; ++behind) {
        face.v[behind - 1][2] = -1.0f;
        CHECK(corners_behind(face.v) == behind);
        CHECK(facing(face.v, 1) == (behind % 2 ? -1 : 1));
        CHECK(facing(face.v, 0) == 1);
    }
    CHECK(facing(FACE.with(0, 0, NAN).v, 1) == 0);
}

void test_degenerate() {
    CHECK(!degenerate(FACE.v));
    CHECK(degenerate(FACE.with(2, 1, -0.5f).v));
    const vec3 point[3] = {FACE.v[0], FACE.v[0], FACE.v[0]};
    CHECK(degenerate(point));
    // The height decides: an area of a base of 1 is as large as it.
    CHECK(degenerate(FACE.with(2, 1, -0.5f + 0.5f * NARROWEST).v));
    CHECK(!degenerate(FACE.with(2, 1, -0.5f + 4.0f * NARROWEST).v));
}

void test_in_front() {
    for (int perspective : {0, 1}) {
        CHECK(in_front(FACE.v, perspective) == 1);
        CHECK(in_front(FACE.with(1, 0, 1e12f).v, perspective) == 1);
        for (float value : HUGE_NUMBERS)
            for (int n = 0; n < 9; ++n) CHECK(in_front(FACE.with(n / 3, n % 3, value).v, perspective) == -1);
    }
    const Corners crossing = FACE.with(0, 2, -1.0f), behind = crossing.with(1, 2, -1.0f).with(2, 2, -1.0f);
    CHECK(in_front(crossing.v, 1) == 0 && in_front(crossing.v, 0) == 1);
    CHECK(in_front(behind.v, 1) == -1 && in_front(behind.v, 0) == 1);
    for (float zero : {0.0f, -0.0f}) CHECK(in_front(FACE.with(0, 2, zero).v, 1) == -1);
}

// The box holds each pixel whose centre is inside, lies in the image, and is no wider than a pixel more.
void test_pixel_box() {
    const int height = 10, width = 20;
    Scene scene = {};
    scene.height = height, scene.width = width;
    const Box box = pixel_box(FACE.v, 1, scene);
    CHECK(box.left == 5 && box.right == 14 && box.bottom == 2 && box.top == 7);
    const Box everything = pixel_box(FACE.v, 0, scene);
    CHECK(everything.left == 0 && everything.right == 19 && everything.bottom == 0 && everything.top == 9);
    for (float x : {-1e12f, -3.0f, 3.0f, 1e12f}) {
        const Corners outside = FACE.with(0, 0, x).with(1, 0, x).with(2, 0, x);
        CHECK(pixel_box(outside.v, 1, scene).is_empty());
    }
    for (float value : HUGE_NUMBERS)
        for (int n = 0; n < 6; ++n) {
            const Box part = pixel_box(FACE.with(n / 2, n % 2, value).v, 1, scene);
            CHECK(part.left >= 0 && part.right < width && part.bottom >= 0 && part.top < height);
        }
    for (int i = 0; i < width; ++i) {  // a point at each centre is in the box of that pixel
        Corners point = FACE;
        for (vec3& corner : point.v) corner = {pixel_centre(i, width), pixel_centre(i / 2, height), 1.0f};
        const Box own = pixel_box(point.v, 1, scene);
        CHECK(own.left == i && own.right == i && own.bottom == i / 2 && own.top == i / 2);
    }
}

void test_box_of_face() {
    const Corners faces[] = {FACE, FACE.with(0, 0, NAN)};
    const Scene scene = {faces[0].v, nullptr, 1, 2, 10, 20, 1, 0, 0};
    CHECK(!box_of_face(scene, 0, 0).is_empty());
    CHECK(box_of_face(scene, 0, 1).is_empty());
    CHECK(scene.row_start(0, 9) == 0 && scene.row_start(1, 0) == 380 && scene.area() == 200);
}

// With all corners at depth 1 they are the weights; of a face without an area none is inside.
void test_homogeneous_weights() {
    const vec3d a = homogeneous_weights(FACE.v, 0.0f, 0.0f);
    CHECK(fabs(a[0] - 0.25) < 1e-7 && fabs(a[1] - 0.25) < 1e-7 && fabs(a[2] - 0.5) < 1e-7);
    const Corners line = FACE.with(2, 1, -0.5f);
    CHECK(homogeneous_weights(line.v, 0.0f, 0.0f)[0] < 0.0);
}

int main() {
    test_pixels();
    test_facing();
    test_degenerate();
    test_in_front();
    test_pixel_box();
    test_box_of_face();
    test_homogeneous_weights();
    return failures != 0;
}
