// The lit colour of each pixel, from the cube of texels or the corner colours of its face; and its gradient.
#pragma once

#include "cube.h"
#include "face.h"
#include "images.h"

namespace nr {

struct SampleCubes {
    Scene scene;
    LitCubes textures;
    Background background;
    int each;      // rows of a task
    float* color;  // [images, 3, height, width]
};

// Compute the lit colours of the corners of one face of one image, [images, count, 3].
struct LightCorners {
    Scene scene;        // only the corners of its faces
    LitCubes textures;  // of at most one texel
    vec3* lit;
};

NR_FUNC void light_corners(const LightCorners& call, int task) {
    const int b = task / call.scene.count, f = task % call.scene.count;
    vec3* to = call.lit + (int64)task * 3;
    to[0] = to[1] = to[2] = vec3{};
    if (!call.textures.has(b, f)) return;
    const int side = facing(call.scene.corners(b, f), call.scene.perspective) < 0;
    const vec3 *colors = call.textures.cube(call.scene, b, f), &light = call.textures.light_on(call.scene, b, f, side);
    for (int k = 0; k < 3; ++k)
        for (int c = 0; c < 3; ++c) to[k][c] = colors[call.textures.size == 0 ? k : 0][c] * light[c];
}

struct SampleRows {
    const SampleCubes& call;

    typedef vec3 Factors;
    NR_FUNC void fresh(const Face& face, const Place& place, Factors& factors) const {
        const int side = visible_side(face.v, face.perspective);
        factors = call.textures.light_on(call.scene, place.image, place.face, side);
    }
    NR_FUNC void empty(int count, const Place& place) const {
        const int row = call.scene.height - 1 - place.j;
        for (int c = 0; c < 3; ++c)
            call.background.copy(place.image, c, row, place.i, count, first(place) + c * call.scene.area());
    }
    NR_FUNC void one(const Face&, const Point<float>& point, const Place& place, const Factors& factors) const {
        const vec3 mixed = blend(point.weights, place);
        for (int c = 0; c < 3; ++c) first(place)[c * call.scene.area()] = mixed[c] * factors[c];
    }
#if NR_LANES
    void run(const Face&, const Point<floats8>& points, int count, const Place& place, const Factors& factors) const {
        const LitCubes& textures = call.textures;
        floats8 mixed[3];
        const vec3* cube = textures.cube(call.scene, place.image, place.face);
        if (textures.is_small()) CubeOfEight(points.weights, textures.size, textures.eps).blend(cube, mixed);
        else {
            const CubePoints<floats8> inside({points.weights, textures.size, textures.eps}, textures.size);
            vec3 blended[8];
            for (int n = 0; n < count; ++n) blended[n] = Cube(inside, n, textures.size).blend(cube);
            load(blended, mixed);
        }
        float* to = first(place);
        for (int c = 0; c < 3; ++c, to += call.scene.area()) {
            mixed[c] *= factors[c];
            if (place.i + 8 <= call.scene.width) store(to, mixed[c]);
            else
                for (int n = 0; n < count; ++n) to[n] = mixed[c][n];
        }
    }
#endif
    // The address of the first channel of a pixel.
    NR_FUNC float* first(const Place& place) const {
        return call.color + place.pixel + 2 * place.image * call.scene.area();
    }
    NR_FUNC vec3 blend(const float* weights, const Place& place) const {
        const LitCubes& textures = call.textures;
        return Cube(weights, textures.size, textures.eps).blend(textures.cube(call.scene, place.image, place.face));
    }
};

// The pixels of a task.
NR_FUNC void sample_pixels(const SampleCubes& call, int task) {
    over_rows<SampleRows::Factors>(call.scene, task, call.each, SampleRows{call});
}

struct SampleCubesBackward {
    Scene scene;
    LitCubes textures;
    ImageGrad grad;                          // gradient to the colours
    int textures_too, light_too, faces_too;  // whether these gradients are needed
    const int* visible;                      // mask of visible faces, [images, count + 1]; on the CPU
    int run;                                 // pixels of a task on CUDA
    vec3* to_textures;                       // as the texels; 0 before, on CUDA
    vec3* to_light;                          // [images, 2, count], 0 before
    vec3* to_faces;                          // [images, count, 3], 0 before
};

struct CubeBackward {
    const SampleCubesBackward& call;
    const vec3* cube;
    const vec3 factor;
    vec3* to_cube;
    const bool exclusive;
    const Slopes slopes;
    CornerSums<float> sums = {};
    vec3 lit = {};  // gradient to the light
    const int size = call.textures.size;
#if NR_LANES
    vec3 lit_cube[8] = {};  // for corner colours: minus that of the first corner
    CubeOfEight::Sums sums_of_texels = {};
    CornerSums<floats8> sums_of_eights = {};
    floats8 lit_of_eights[3] = {}, sums_of_color[3] = {};

    void prepare() {
        const vec3 least = size == 0 ? cube[0] : vec3{};
        for (int n = 0; n < call.textures.volume(); ++n) lit_cube[n] = times(cube[n] - least, factor);
    }
    void eight(const Face& face, const Point<floats8>& points, const Place& place, ints8 here) {
        floats8 cotangent[3], to_weights[3];
        for (int c = 0; c < 3; ++c) {
            call.grad.prefetch(3 * (int64)place.image + c, call.scene.height - 1 - place.j - ROWS_AHEAD, place.i);
            cotangent[c] = select(here, call.grad.eight(row(place, c), place.i), floats8{});
        }
        if (size == 0) return corners(points.weights, cotangent);
        if (call.textures.is_small()) {
            const CubeOfEight inside(points.weights, size, call.textures.eps);
            if (call.textures_too) inside.scatter(sums_of_texels, cotangent);
            else if (call.light_too) {
                floats8 color[3];
                inside.blend(cube, color);
                for (int c = 0; c < 3; ++c) lit_of_eights[c] += color[c] * cotangent[c];
            }
            if (call.faces_too) inside.slope(lit_cube, cotangent, to_weights);
        } else {
            const CubePoints<floats8> inside({points.weights, size, call.textures.eps}, size);
            vec3 cotangents[8], slopes[8] = {};
            store(cotangents, cotangent[0], cotangent[1], cotangent[2]);
            for (unsigned left = bits(here); left; left &= left - 1) {
                const int n = lowest_bit(left);
                const Cube at(inside, n, size);
                const vec3 lit_cotangent = times(cotangents[n], factor);
                vec3 color;
                at.blend_and_slope(cube, lit_cotangent, color, slopes[n]);
                lit += times(color, cotangents[n]);
                if (call.textures_too) at.scatter(to_cube, lit_cotangent, exclusive);
            }
            load(slopes, to_weights);
        }
        if (call.faces_too) sums_of_eights.add(face, slopes, points, to_weights, floats8{}, here);
    }
    // Corner colours need only sums; see `CornerSums::add_attributes`.
    void corners(const floats8* weights, const floats8* cotangent) {
        CubeOfEight(weights, 0, 0.0f).scatter(sums_of_texels, cotangent);
        if (!call.faces_too || !call.scene.perspective) return;
        floats8 color = {};
        for (int c = 0; c < 3; ++c) color += cotangent[c] * (weights[1] * lit_cube[1][c] + weights[2] * lit_cube[2][c]);
        for (int k = 0; k < 3; ++k) sums_of_color[k] += weights[k] * color;
    }
    void finish_eights(const Face& face) {
        sums.add(sums_of_eights);
        for (int c = 0; c < 3; ++c) lit[c] += sum(lit_of_eights[c]);
        if (!call.textures.is_small() || !(call.textures_too || size == 0)) return;
        vec3 cotangents[8];
        for (int n = 0; n < call.textures.volume(); ++n) {
            cotangents[n] = sums_of_texels.of(n);
            lit += times(cube[n], cotangents[n]);
            if (call.textures_too) to_cube[n] += times(cotangents[n], factor);
        }
        if (size == 0 && call.faces_too)
            sums.add_attributes<3>(face, slopes, lit_cube[0].c, cotangents[0].c, sums_of_color);
    }
#endif
    NR_FUNC void one(const Face& face, const Point<float>& point, const Place& place) {
        vec3 cotangent;
        for (int c = 0; c < 3; ++c) cotangent[c] = call.grad.at(row(place, c), place.i);
        const vec3 to_weights = texels(Cube(point.weights, size, call.textures.eps), cotangent);
        if (call.faces_too) sums.add(face, slopes, point, to_weights.c, 0.0f, true);
    }
    NR_FUNC const float* row(const Place& place, int c) const {
        return call.grad.row(3 * (int64)place.image + c, call.scene.height - 1 - place.j);
    }
    // Propagate the gradient of a pixel's colour to light and texels; returns the gradient to the corners' weights.
    NR_FUNC vec3 texels(const Cube& at, const vec3& cotangent) {
        if (call.light_too) lit += times(at.blend(cube), cotangent);
        const vec3 scaled = times(cotangent, factor);
        if (call.textures_too) at.scatter(to_cube, scaled, exclusive);
        return call.faces_too ? at.slope(cube, scaled) : vec3{};
    }
};

// The pixels of a box that show face f, with the cube of image ``owner``. If ``exclusive``, no other task writes to it.
NR_FUNC void cube_backward(
    const SampleCubesBackward& call, int image, int owner, int f, const Box& box, bool exclusive) {
    const Scene& scene = call.scene;
    const int64 at = call.textures.place(scene, owner, f);
    Face face;
    face.set(scene.corners(image, f), scene);
    const int side = visible_side(face.v, scene.perspective);
    const vec3 factor = call.textures.light_on(scene, image, f, side);
    vec3* to_cube = call.textures_too ? call.to_textures + at : nullptr;
    CubeBackward visitor = {call, call.textures.texels + at, factor, to_cube, exclusive, Slopes(face)};
#if NR_LANES
    if (call.faces_too && call.textures.is_small()) visitor.prepare();
#endif
    over_face(scene, face, image, f, box, true, visitor);
    if (call.faces_too) visitor.sums.give(call.to_faces + ((int64)image * scene.count + f) * 3, exclusive);
    if (call.light_too) atomic_add(call.to_light + (2 * (int64)image + side) * scene.count + f, visitor.lit);
}

// The pixels that show one face, in one image or, if images share cubes, in all. Clearing the cube here saves a pass
// over the memory.
NR_FUNC void cubes_of_face_backward(const SampleCubesBackward& call, int task) {
    const LitCubes& textures = call.textures;
    const int owner = task / call.scene.count, face = task % call.scene.count;
    if (!textures.has(owner, face)) return;
    if (call.textures_too)
        memset(call.to_textures + textures.place(call.scene, owner, face), 0, textures.volume() * sizeof(vec3));
    for_each_view(call.scene, call.visible, textures.cubes, task, [&](int image, int, int f, const Box& box) {
        cube_backward(call, image, owner, f, box, true);
    });
}

// A run of contiguous pixels, face by face, on CUDA.
NR_FUNC void cubes_of_run_backward(const SampleCubesBackward& call, int task) {
    for_each_run(call.scene, task, call.run, [&](int image, int f, int j, int first, int last) {
        cube_backward(call, image, min(image, call.textures.cubes - 1), f, Box{first, last, j, j}, false);
    });
}

struct SampleCubesForward {
    Scene scene;
    LitCubes textures;
    Motion motion;
    const vec3* to_light;  // change of the light, [directions, lamps, 2, count], or null
    float* change;         // [directions, images, 3, height, width]
};

// The derivatives of a lit colour by the weights of the corners and by the light.
template <class F>
struct ColorSlopes {
    F by_weights[3][3];  // for each channel
    F by_light[3];       // the unlit colour
    int side;            // visible side of the face
};

struct ColorChanges {
    const SampleCubesForward& call;

    template <class F>
    NR_FUNC ColorSlopes<F> at(const Face& face, const Point<F>& points, const Place& place) const {
        const LitCubes& textures = call.textures;
        const vec3* cube = textures.cube(call.scene, place.image, place.face);
        const int side = visible_side(face.v, face.perspective);
        const vec3 factors = textures.light_on(call.scene, place.image, place.face, side);
        ColorSlopes<F> slopes;
        slopes.side = side;
        for (int n = 0; n < Lanes<F>::WIDTH; ++n) {
            const float weights[3] = {
                lane(points.weights[0], n), lane(points.weights[1], n), lane(points.weights[2], n)};
            const Cube inside(weights, textures.size, textures.eps);
            const vec3 color = inside.blend(cube);
            for (int c = 0; c < 3; ++c) {
                set_lane(slopes.by_light[c], n, color[c]);
                vec3 unit = {};
                unit[c] = factors[c];
                const vec3 slope = inside.slope(cube, unit);
                for (int k = 0; k < 3; ++k) set_lane(slopes.by_weights[c][k], n, slope[k]);
            }
        }
        return slopes;
    }
#if NR_LANES
    ColorSlopes<floats8> at(const Face& face, const Point<floats8>& points, const Place& place) const {
        const LitCubes& textures = call.textures;
        if (!textures.is_small()) return at<floats8>(face, points, place);
        const vec3* cube = textures.cube(call.scene, place.image, place.face);
        const int side = visible_side(face.v, face.perspective);
        const vec3 factors = textures.light_on(call.scene, place.image, place.face, side);
        const CubeOfEight inside(points.weights, textures.size, textures.eps);
        ColorSlopes<floats8> slopes;
        slopes.side = side;
        if (call.to_light) inside.blend(cube, slopes.by_light);
        for (int c = 0; c < 3; ++c) {
            floats8 unit[3] = {};
            unit[c] += factors[c];
            inside.slope(cube, unit, slopes.by_weights[c]);
        }
        return slopes;
    }
#endif
    template <class F>
    NR_FUNC void store(
        const ColorSlopes<F>& slopes, const PointChange<F>& moved, int t, int count, const Place& place) const {
        float* to = first(t, place);
        const Scene& scene = call.scene;
        vec3 light = {};
        if (call.to_light)
            light = call.textures.light_on(scene, place.image, place.face, slopes.side, call.to_light, t);
        for (int c = 0; c < 3; ++c, to += scene.area()) {
            const F* by = slopes.by_weights[c];
            F change = by[0] * moved.weights[0] + by[1] * moved.weights[1] + by[2] * moved.weights[2];
            if (call.to_light) change += slopes.by_light[c] * light[c];
            store_first(to, change, count);
        }
    }
    NR_FUNC void clear(int t, int count, const Place& place) const {
        float* to = first(t, place);
        for (int c = 0; c < 3; ++c, to += call.scene.area()) memset(to, 0, count * sizeof(float));
    }
    NR_FUNC float* first(int t, const Place& place) const {
        const int64 area = call.scene.area();
        return call.change + 3 * t * call.scene.images * area + 2 * place.image * area + place.pixel;
    }
};

// The pixels of a task.
NR_FUNC void sample_pixels_forward(const SampleCubesForward& call, int task) {
    over_changes(call.scene, call.motion, task, ColorChanges{call});
}

}  // namespace nr
