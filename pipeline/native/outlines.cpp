// The outermost points of objects in images.
#include "lenses.h"

#include <vector>

namespace outlines {

struct Vector {
    double x, y, z;
};

// A box in the optical frame: its axes, its centre, and half its size along the axes, metres.
struct BoxInCamera {
    Vector along, across, up, centre, half;
};

// The place of a point along the axes of a box, from its sign (3,) and offset (3,).
LIDCAM_PART Vector place_of(const double *sign, const double *offset, const Vector &half) {
    return {sign[0] * half.x + offset[0], sign[1] * half.y + offset[1], sign[2] * half.z + offset[2]};
}

// A place along the axes of a box, in the optical frame.
LIDCAM_PART Vector in_camera(const Vector &place, const BoxInCamera &box) {
    return {
        place.x * box.along.x + place.y * box.across.x + place.z * box.up.x + box.centre.x,
        place.x * box.along.y + place.y * box.across.y + place.z * box.up.y + box.centre.y,
        place.x * box.along.z + place.y * box.across.z + place.z * box.up.z + box.centre.z,
    };
}

// Nothing that is read here is written: box and lens are copies, and the outputs are restricted. Otherwise the compiler
// takes one point at a time. `invalid` is as wide as a pixel for the same reason.
LIDCAM_PART bool show_by(const double *signs, const double *offsets, int64_t count, BoxInCamera box, Lens lens,
                         bool equidistant, double *__restrict u, double *__restrict v) {
    int64_t invalid = 0;
    for (int64_t s = 0; s < count; s++) {
        const Vector point = in_camera(place_of(signs + 3 * s, offsets + 3 * s, box.half), box);
        const Pixel pixel = pixel_of(point.x, point.y, point.z, lens, equidistant);
        u[s] = pixel.u;
        v[s] = pixel.v;
        invalid |= pixel.valid ? 0 : 1;
    }
    return invalid == 0;
}

// The pixels of the points (count,) of an object, and whether all are ahead and within the lens model.
LIDCAM_HOT bool show(const double *signs, const double *offsets, int64_t count, const BoxInCamera &box,
                     const Lens &lens, bool equidistant, double *u, double *v) {
    if (equidistant) return show_by(signs, offsets, count, box, lens, true, u, v);
    return show_by(signs, offsets, count, box, lens, false, u, v);  // by itself: several points at once
}

BoxInCamera box_in_camera(const double *center, const double *size, double cos, double sin, const double *R,
                          const double *t) {
    const double x = center[0], y = center[1], z = center[2];
    return {
        {R[0] * cos + R[1] * sin, R[3] * cos + R[4] * sin, R[6] * cos + R[7] * sin},
        {R[1] * cos - R[0] * sin, R[4] * cos - R[3] * sin, R[7] * cos - R[6] * sin},
        {R[2], R[5], R[8]},
        {
            R[0] * x + R[1] * y + R[2] * z + t[0],
            R[3] * x + R[4] * y + R[5] * z + t[1],
            R[6] * x + R[7] * y + R[8] * z + t[2],
        },
        {size[0] / 2, size[1] / 2, size[2] / 2},
    };
}

struct Ends {
    int64_t low, high;
};

// The places of the lowest and the highest of values (count,), of those alike the first. Both change seldom.
Ends ends_of(const double *values, int64_t count) {
    double low = values[0], high = values[0];
    Ends ends{0, 0};
    for (int64_t s = 1; s < count; s++) {
        if (values[s] < low) {
            low = values[s];
            ends.low = s;
        } else if (values[s] > high) {
            high = values[s];
            ends.high = s;
        }
    }
    return ends;
}

// The leftmost, topmost, rightmost and bottommost point of an object, of which the first and the third count across.
constexpr int EDGES = 4;

// These points in the optical frame, and derivatives of the image coordinate that counts by them.
struct EdgePoints {
    double x[EDGES], y[EDGES], z[EDGES];
    double by_x[EDGES], by_y[EDGES], by_z[EDGES];
};

LIDCAM_PART void derive_by(EdgePoints &points, Lens lens, bool equidistant) {
    for (int e = 0; e < EDGES; e++) {
        const Slopes by = slopes_of(points.x[e], points.y[e], points.z[e], lens, equidistant);
        const bool is_across = e % 2 == 0;
        points.by_x[e] = is_across ? by.u_by_x : by.v_by_x;
        points.by_y[e] = is_across ? by.u_by_y : by.v_by_y;
        points.by_z[e] = is_across ? by.u_by_z : by.v_by_z;
    }
}

LIDCAM_HOT void derive(EdgePoints &points, const Lens &lens, bool equidistant) {
    if (equidistant) {
        derive_by(points, lens, true);
    } else {  // all points at once
        derive_by(points, lens, false);
    }
}

// Derivatives (7,) of an image coordinate by x, y, yaw, length, width, height, z of a box, from those by a point in the
// optical frame, which has this sign (3,) and this place along the axes of the box.
void by_box(const Vector &by_point, const BoxInCamera &box, double cos, double sin, const double *sign,
            const Vector &place, double *slopes) {
    const auto &[along, across, up, centre, half] = box;
    // Per metre along the box's own axes.
    const double by_length = by_point.x * along.x + by_point.y * along.y + by_point.z * along.z;
    const double by_width = by_point.x * across.x + by_point.y * across.y + by_point.z * across.z;
    const double by_height = by_point.x * up.x + by_point.y * up.y + by_point.z * up.z;
    slopes[0] = by_length * cos - by_width * sin;
    slopes[1] = by_length * sin + by_width * cos;
    slopes[2] = by_width * place.x - by_length * place.y;
    slopes[3] = by_length * sign[0] / 2;
    slopes[4] = by_width * sign[1] / 2;
    slopes[5] = by_height * sign[2] / 2;
    slopes[6] = by_height;
}

nb::object outermost_points(In2<double> centers, In2<double> sizes, In1<double> cosines, In1<double> sines,
                            In1<int64_t> rows, In2<double> signs, In3<double> offsets, In3<double> rotations,
                            In2<double> translations, In3<double> K, In2<double> coefficients, In1<bool> equidistant,
                            In1<double> limits) {
    const size_t boxes = rows.shape(0), count = signs.shape(0);
    Out<double> edges({boxes, 4}), slopes({boxes, 4, 7});
    Out<int64_t> makers({boxes, 4});
    Out<bool> valid({boxes});
    {
        nb::gil_scoped_release unlocked;
        const LensArrays lenses{K.data(), coefficients.data(), equidistant.data(), limits.data()};
        std::vector<double> u(count), v(count);
        for (size_t q = 0; q < boxes; q++) {
            const int64_t p = rows.data()[q];
            const double cos = cosines.data()[q], sin = sines.data()[q];
            const Lens lens = lens_of(lenses, p);
            const BoxInCamera box = box_in_camera(centers.data() + 3 * q, sizes.data() + 3 * q, cos, sin,
                                                  rotations.data() + 9 * p, translations.data() + 3 * p);
            const double *offset = offsets.data() + (offsets.shape(0) > 1 ? 3 * count * p : 0);
            const bool is_equidistant = lenses.equidistant[p];
            valid[q] = show(signs.data(), offset, count, box, lens, is_equidistant, u.data(), v.data());
            const Ends across = ends_of(u.data(), count), down = ends_of(v.data(), count);
            const int64_t outermost[EDGES] = {across.low, down.low, across.high, down.high};
            EdgePoints points;
            Vector places[EDGES];
            for (int e = 0; e < EDGES; e++) {
                const int64_t s = outermost[e];
                places[e] = place_of(signs.data() + 3 * s, offset + 3 * s, box.half);
                const Vector point = in_camera(places[e], box);
                points.x[e] = point.x, points.y[e] = point.y, points.z[e] = point.z;
            }
            derive(points, lens, is_equidistant);
            for (int e = 0; e < EDGES; e++) {
                const int64_t s = outermost[e];
                edges(q, e) = e % 2 == 0 ? u[s] : v[s];
                makers(q, e) = s;
                by_box({points.by_x[e], points.by_y[e], points.by_z[e]}, box, cos, sin, signs.data() + 3 * s, places[e],
                       slopes.data() + 28 * q + 7 * e);
            }
        }
    }
    return nb::make_tuple(edges.numpy(), slopes.numpy(), makers.numpy(), valid.numpy());
}

void add(nb::module_ &kernels) {
    kernels.def("outermost_points", &outermost_points, array("centers"), array("sizes"), array("cosines"),
                array("sines"), array("rows"), array("signs"), array("offsets"), array("rotations"),
                array("translations"), array("K"), array("coefficients"), array("equidistant"), array("limits"));
}

}  // namespace outlines
