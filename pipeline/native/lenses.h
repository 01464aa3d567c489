// The lens models of `core.camera`, for one point at a time.
//
// For a point at (x, y) = (X / Z, Y / Z) with r2 = x x + y y, a lens of `rational_polynomial` (of which `plumb_bob` and
// lenses without distortion are cases) shows it at
//
//     x scale(r2) + 2 p1 x y + p2 (r2 + 2 x x),   y scale(r2) + p1 (r2 + 2 y y) + 2 p2 x y
//
// and an `equidistant` one at (x, y) scale(r2), where the scale turns the tangent of the angle to the axis into a
// polynomial of the angle. Derivatives follow from that of the scale by r2.
#pragma once

#include "arrays.h"

#include <cmath>

// Least depth of a point in the image, metres: half of `core.camera.NEAR_M`.
constexpr double LEAST_DEPTH_M = 0.005;

// Below this radius the quotients of the equidistant model lose their digits: the series about the axis stands in.
constexpr double ON_AXIS = 1e-4;

// The fields of `Lenses`, as kernels take them.
struct LensArrays {
    const double *K;             // (P, 3, 3)
    const double *coefficients;  // (P, 8)
    const bool *equidistant;     // (P,)
    const double *limits;        // (P,)
};

struct Lens {
    double fx, fy, cx, cy, skew;  // focal lengths, centre and skew, pixels
    double p1, p2;                // tangential coefficients; 0 if equidistant
    double k1, k2, k3, k4, k5, k6, k7;
    double limit;  // of the radius; of the angle to the axis if equidistant
};

struct Pixel {
    double u, v;
    bool valid;  // ahead of the camera and within the lens model
};

struct Slopes {
    double u_by_x, u_by_y, u_by_z, v_by_x, v_by_y, v_by_z;
};

LIDCAM_PART Lens lens_of(const LensArrays &lenses, int64_t p) {
    const double *K = lenses.K + 9 * p, *k = lenses.coefficients + 8 * p;
    const bool equidistant = lenses.equidistant[p];
    Lens lens{};
    lens.fx = K[0], lens.fy = K[4], lens.cx = K[2], lens.cy = K[5], lens.skew = K[1];
    lens.p1 = equidistant ? 0.0 : k[2];
    lens.p2 = equidistant ? 0.0 : k[3];
    lens.k1 = k[0], lens.k2 = k[1];
    lens.k3 = equidistant ? k[2] : k[4];
    lens.k4 = equidistant ? k[3] : 0.0;
    lens.k5 = k[5], lens.k6 = k[6], lens.k7 = k[7];
    lens.limit = lenses.limits[p];
    return lens;
}

// Whether a point is where the lens model is one-to-one.
LIDCAM_PART bool is_within(double r2, const Lens &lens, bool equidistant) {
    return equidistant ? std::atan(std::sqrt(r2)) < lens.limit : r2 < lens.limit * lens.limit;
}

// The radial scale at a squared radius.
LIDCAM_PART double scale_at(double r2, const Lens &lens, bool equidistant) {
    const auto &[fx, fy, cx, cy, skew, p1, p2, k1, k2, k3, k4, k5, k6, k7, limit] = lens;
    if (equidistant) {
        const double radius = std::sqrt(r2), theta = std::atan(radius), t2 = theta * theta;
        const double grown = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))));
        return radius >= ON_AXIS ? grown / radius : 1 + (k1 - 1.0 / 3) * r2;
    }
    return (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k5 + r2 * (k6 + r2 * k7)));
}

// The derivative of the radial scale by the squared radius.
LIDCAM_PART double scale_slope(double r2, double scale, const Lens &lens, bool equidistant) {
    const auto &[fx, fy, cx, cy, skew, p1, p2, k1, k2, k3, k4, k5, k6, k7, limit] = lens;
    if (equidistant) {
        const double radius = std::sqrt(r2), theta = std::atan(radius), t2 = theta * theta;
        const double growth = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)));
        return radius >= ON_AXIS ? (growth / (1 + r2) - scale) / (2 * r2) : k1 - 1.0 / 3;
    }
    const double top_slope = k1 + r2 * (2 * k2 + 3 * r2 * k3);
    const double bottom_slope = k5 + r2 * (2 * k6 + 3 * r2 * k7);
    return (top_slope - scale * bottom_slope) / (1 + r2 * (k5 + r2 * (k6 + r2 * k7)));
}

// The pixel of a point in the optical frame.
LIDCAM_PART Pixel pixel_of(double x, double y, double z, const Lens &lens, bool equidistant) {
    const bool is_ahead = z > LEAST_DEPTH_M;
    const double depth = is_ahead ? z : 1.0;
    x /= depth;
    y /= depth;
    double r2 = x * x + y * y;
    const bool is_inside = is_within(r2, lens, equidistant);
    r2 = is_inside ? r2 : 0.0;
    const double scale = scale_at(r2, lens, equidistant), p1 = lens.p1, p2 = lens.p2;
    const double x_lens = x * scale + 2 * p1 * x * y + p2 * (r2 + 2 * x * x);
    const double y_lens = y * scale + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y;
    const double u = lens.fx * x_lens + lens.skew * y_lens + lens.cx + 0.5, v = lens.fy * y_lens + lens.cy + 0.5;
    return {u, v, bool(is_ahead & is_inside)};
}

// Derivatives of the pixel by the point in the optical frame.
LIDCAM_PART Slopes slopes_of(double x, double y, double z, const Lens &lens, bool equidistant) {
    const double depth = z > LEAST_DEPTH_M ? z : 1.0;
    x /= depth;
    y /= depth;
    double r2 = x * x + y * y;
    r2 = is_within(r2, lens, equidistant) ? r2 : 0.0;
    const double scale = scale_at(r2, lens, equidistant), slope = scale_slope(r2, scale, lens, equidistant);
    const double p1 = lens.p1, p2 = lens.p2;
    const double xx = scale + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x;
    const double xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y;  // x by y, and y by x
    const double yy = scale + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x;
    const double u_by_x = (lens.fx * xx + lens.skew * xy) / depth, u_by_y = (lens.fx * xy + lens.skew * yy) / depth;
    const double v_by_x = lens.fy * xy / depth, v_by_y = lens.fy * yy / depth;
    return {u_by_x, u_by_y, -u_by_x * x - u_by_y * y, v_by_x, v_by_y, -v_by_x * x - v_by_y * y};
}
