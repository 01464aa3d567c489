// Positions of points in another frame, and each moved as of its own time.
#include "arrays.h"

namespace motion {

LIDCAM_HOT void move(const float *__restrict xyz, int64_t count, const float *matrix, float *__restrict out) {
    float m[12];
    for (int i = 0; i < 12; i++) m[i] = matrix[i];
    for (int64_t i = 0; i < count; i++) {
        const float x = xyz[3 * i], y = xyz[3 * i + 1], z = xyz[3 * i + 2];
        for (int axis = 0; axis < 3; axis++)
            out[3 * i + axis] = m[4 * axis] * x + m[4 * axis + 1] * y + m[4 * axis + 2] * z + m[4 * axis + 3];
    }
}

nb::object moved(In2<float> xyz, In2<float> matrix) {
    Out<float> out({xyz.shape(0), 3}, unset);
    {
        nb::gil_scoped_release unlocked;
        move(xyz.data(), int64_t(xyz.shape(0)), matrix.data(), out.data());
    }
    return out.numpy();
}

LIDCAM_HOT void move_each(const float *__restrict xyz, int64_t count, const int64_t *since_ns, const float *matrices,
                          int64_t step_ns, float *__restrict out) {
    for (int64_t i = 0; i < count; i++) {
        const uint64_t knot = uint64_t(since_ns[i]) / uint64_t(step_ns);  // a division that need not look at the sign
        const float share = float(double(since_ns[i] - int64_t(knot) * step_ns) / double(step_ns));
        const float x = xyz[3 * i], y = xyz[3 * i + 1], z = xyz[3 * i + 2];
        for (int axis = 0; axis < 3; axis++) {
            const float *first = matrices + 12 * knot + 4 * axis, *second = first + 12;
            float m[4];
            for (int k = 0; k < 4; k++) m[k] = first[k] + share * (second[k] - first[k]);
            out[3 * i + axis] = m[0] * x + m[1] * y + m[2] * z + m[3];
        }
    }
}

nb::object moved_each(In2<float> xyz, In1<int64_t> since_ns, In3<float> matrices, int64_t step_ns) {
    Out<float> out({xyz.shape(0), 3}, unset);
    {
        nb::gil_scoped_release unlocked;
        move_each(xyz.data(), int64_t(xyz.shape(0)), since_ns.data(), matrices.data(), step_ns, out.data());
    }
    return out.numpy();
}

void add(nb::module_ &kernels) {
    kernels.def("moved", &moved, array("xyz"), array("matrix"));
    kernels.def("moved_each", &moved_each, array("xyz"), array("since_ns"), array("matrices"), nb::arg("step_ns"));
}

}  // namespace motion
