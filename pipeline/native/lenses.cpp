// Points in the images of many cameras, each row of points in that of its own, and rays of pixels.
#include "lenses.h"

#include <limits>

namespace lenses {

// Steps of Newton's method; a dozen are enough at 85 degrees from the axis of a fisheye lens.
constexpr int MAX_STEPS = 30;

// A ray is found when it is projected this near to its pixel, across and down.
constexpr double NEAR_PX = 1e-4;

LIDCAM_PART void project_row(const double *points, int64_t count, const Lens &lens, bool equidistant, double *pixels,
                             bool *valid) {
    for (int64_t s = 0; s < count; s++) {
        const Pixel found = pixel_of(points[3 * s], points[3 * s + 1], points[3 * s + 2], lens, equidistant);
        pixels[2 * s] = found.u;
        pixels[2 * s + 1] = found.v;
        valid[s] = found.valid;
    }
}

LIDCAM_HOT void project_all(const double *points, int64_t rows, int64_t count, const LensArrays &lenses, double *pixels,
                            bool *valid) {
    for (int64_t p = 0; p < rows; p++) {
        const Lens lens = lens_of(lenses, p);
        const int64_t first = p * count;
        if (lenses.equidistant[p]) {
            project_row(points + 3 * first, count, lens, true, pixels + 2 * first, valid + first);
        } else {  // by itself: without an arctangent, several points at once
            project_row(points + 3 * first, count, lens, false, pixels + 2 * first, valid + first);
        }
    }
}

// The direction (3,) of a pixel, of depth 1, and whether there is one.
bool find_ray(const double *pixel, const Lens &lens, bool equidistant, double *ray) {
    double y = (pixel[1] - 0.5 - lens.cy) / lens.fy;
    double x = (pixel[0] - 0.5 - lens.cx - lens.skew * y) / lens.fx;
    double last_x = 0, last_y = 0;  // the optical axis, which is within any lens model
    ray[2] = 1.0;
    for (int step = 0; step < MAX_STEPS; step++) {
        const Pixel reached = pixel_of(x, y, 1.0, lens, equidistant);
        if (!reached.valid) {  // beyond the lens model, as the first step of a lens that bends much may be
            x = (x + last_x) / 2, y = (y + last_y) / 2;
            continue;
        }
        last_x = x, last_y = y;
        const double right = pixel[0] - reached.u, down = pixel[1] - reached.v;
        if (std::fabs(right) <= NEAR_PX && std::fabs(down) <= NEAR_PX) {
            ray[0] = x;
            ray[1] = y;
            return true;
        }
        const Slopes slopes = slopes_of(x, y, 1.0, lens, equidistant);
        const double determinant = slopes.u_by_x * slopes.v_by_y - slopes.u_by_y * slopes.v_by_x;
        const double whole = determinant == 0 ? std::numeric_limits<double>::infinity() : determinant;
        x += (slopes.v_by_y * right - slopes.u_by_y * down) / whole;
        y += (slopes.u_by_x * down - slopes.v_by_x * right) / whole;
    }
    return false;
}

nb::object pixels_of_points(In3<double> points, In3<double> K, In2<double> coefficients, In1<bool> equidistant,
                            In1<double> limits) {
    const size_t rows = points.shape(0), count = points.shape(1);
    Out<double> pixels({rows, count, 2});
    Out<bool> valid({rows, count});
    {
        nb::gil_scoped_release unlocked;
        const LensArrays lenses{K.data(), coefficients.data(), equidistant.data(), limits.data()};
        project_all(points.data(), rows, count, lenses, pixels.data(), valid.data());
    }
    return nb::make_tuple(pixels.numpy(), valid.numpy());
}

nb::object rays_of_pixels(In3<double> pixels, In3<double> K, In2<double> coefficients, In1<bool> equidistant,
                          In1<double> limits) {
    const size_t rows = pixels.shape(0), count = pixels.shape(1);
    Out<double> rays({rows, count, 3});
    Out<bool> found({rows, count});
    {
        nb::gil_scoped_release unlocked;
        const LensArrays lenses{K.data(), coefficients.data(), equidistant.data(), limits.data()};
        for (size_t p = 0; p < rows; p++) {
            const Lens lens = lens_of(lenses, p);
            for (size_t i = p * count; i < (p + 1) * count; i++)
                found[i] = find_ray(pixels.data() + 2 * i, lens, lenses.equidistant[p], rays.data() + 3 * i);
        }
    }
    return nb::make_tuple(rays.numpy(), found.numpy());
}

void add(nb::module_ &kernels) {
    kernels.def("pixels_of_points", &pixels_of_points, array("points"), array("K"), array("coefficients"),
                array("equidistant"), array("limits"));
    kernels.def("rays_of_pixels", &rays_of_pixels, array("pixels"), array("K"), array("coefficients"),
                array("equidistant"), array("limits"));
}

}  // namespace lenses
