// Boxes fitted to clusters: see `detectors/cluster/fitting.py`, `completion.py` and `features.py` there.
#include "arrays.h"
#include "bilinear.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace boxes {

constexpr double INFINITE = std::numeric_limits<double>::infinity();
constexpr double PI = 3.141592653589793;

// Standard deviation of a measured extent below the prior, as a share of the prior; a side may be partly hidden.
constexpr double SHORT_SHARE = 0.2;

// Maximum of missing length, in standard deviations: another object may stand in front.
constexpr double MAX_SHORT_SIGMAS = 3.0;

// Minimum extent of a complete side that faces a lidar, as a share of the prior.
constexpr double WHOLE_SHARE = 0.8;

// Minimum share of the points that lidars beyond each of two ends measured, for both ends to count as seen.
constexpr double BOTH_ENDS_SHARE = 0.1;

// Minimum extent of a complete side with both ends seen, as a share of the prior.
constexpr double BOTH_ENDS_WHOLE_SHARE = 0.5;

// Maximum width of a slender class that rides, as a share of its length: a pedestrian's body hides its far side.
constexpr double MAX_RIDER_SHARE = 0.5;

// Growth of a pedestrian's box away from the lidar: 1 is as a car's, of which only the near sides are seen, 0 about its
// middle.
constexpr double PEDESTRIAN_ANCHOR = 0.25;

// Distance from a box up to which points are of the object: its surface is rough, and the box fits not quite.
constexpr double MARGIN_M = 0.15;

// Height above an object up to which points are looked at.
constexpr double ABOVE_M = 2.0;

// Heights above the ground between which shares of the points are counted.
constexpr double LAYERS_M[] = {0.3, 0.6, 0.9, 1.2, 1.5, 1.9};

// Heights above the ground between which extents are measured; the first begins at the ground.
constexpr double PROFILES_M[] = {0.6, 1.2, 1.9};

// The number of rising steps that a height reaches.
template <size_t N> int64_t steps_below(double height_m, const double (&steps_m)[N]) {
    int64_t step = 0;
    while (step < int64_t(N) && height_m >= steps_m[step]) step++;
    return step;
}

// The ground: normal and offset of its plane; and its relief at the nodes of a grid, of which x and y of the first node
// and the distance of nodes are given.
struct Ground {
    const double *plane, *relief_m, *grid;
    int64_t lines, columns;
};

constexpr int64_t CHUNK = 512;

// Heights above the ground of up to CHUNK points.
LIDCAM_HOT void measure_heights(const float *xyz, const int64_t *rows, int64_t count, const Ground &ground,
                                double *height_m) {
    const double *plane = ground.plane, *grid = ground.grid;
    double x[CHUNK], y[CHUNK], column[CHUNK], line[CHUNK], level_m[CHUNK];
    for (int64_t i = 0; i < count; i++) {
        x[i] = xyz[3 * rows[i]];
        y[i] = xyz[3 * rows[i] + 1];
    }
    for (int64_t i = 0; i < count; i++) {
        column[i] = (x[i] - grid[0]) / grid[2];
        line[i] = (y[i] - grid[1]) / grid[2];
        level_m[i] = -(x[i] * plane[0] + y[i] * plane[1] + plane[3]) / plane[2];
    }
    for (int64_t i = 0; i < count; i++) {
        const double relief = between(ground.relief_m, ground.lines, ground.columns, column[i], line[i]);
        height_m[i] = xyz[3 * rows[i] + 2] - (level_m[i] + relief);
    }
}

nb::tuple points_above_ground(In2<float> xyz, In1<uint8_t> lidar_index, In1<int32_t> time_ns, In1<int64_t> rows,
                              In1<double> plane, In2<double> relief_m, In1<double> grid, In2<double> lidar_xyz,
                              double distance_m, double distance_per_m, double above_m, double below_m) {
    const size_t count = rows.shape(0);
    Out<int64_t> place({count}, unset), lidar({count}, unset);
    Out<double> position({count, 3}, unset), link_distance_m({count}, unset), when_ns({count}, unset);
    size_t kept = 0;
    {
        nb::gil_scoped_release unlocked;
        const Ground ground = {plane.data(), relief_m.data(), grid.data(), int64_t(relief_m.shape(0)),
                               int64_t(relief_m.shape(1))};
        double height_m[CHUNK], *at = position.data(), *link_m = link_distance_m.data(), *when = when_ns.data();
        int64_t *kept_rows = place.data(), *kept_lidar = lidar.data();
        for (size_t i = 0; i < count; i++) {
            if (i % CHUNK == 0)
                measure_heights(xyz.data(), rows.data() + i, std::min(CHUNK, int64_t(count - i)), ground, height_m);
            const double height = height_m[i % CHUNK];
            if (!(above_m < height && height < below_m)) continue;
            const int64_t row = rows.data()[i], own = lidar_index.data()[row];
            const float *point = xyz.data() + 3 * row;
            const double *origin = lidar_xyz.data() + 3 * own;
            const double dx = point[0] - origin[0], dy = point[1] - origin[1], dz = point[2] - origin[2];
            kept_rows[kept] = int64_t(i);
            at[3 * kept] = point[0];
            at[3 * kept + 1] = point[1];
            at[3 * kept + 2] = height;
            kept_lidar[kept] = own;
            link_m[kept] = distance_m + distance_per_m * std::sqrt(dx * dx + dy * dy + dz * dz);
            when[kept++] = time_ns.data()[row];
        }
    }
    return nb::make_tuple(place.numpy(kept), position.numpy(kept), lidar.numpy(kept), link_distance_m.numpy(kept),
                          when_ns.numpy(kept));
}

// Sizes that clusters are compared with, see `Kinds`; and the standard deviations of longer and shorter ones.
struct Kind {
    int64_t class_id;
    double mean[3], limit[3], longer_m[3], shorter_m[3], rarity;
};

// A kind chosen for a cluster: its row; whether the cluster fits; and the squared deviation from it.
struct Choice {
    int64_t row = 0;
    bool fits = false;
    double misfit = 0.0;
};

// The kind whose size is nearest to the measured extents; of the given class, or if that is -1 of those large enough.
// The length along either axis costs what is given.
Choice choose(const std::vector<Kind> &kinds, const double *measured, const double *visible, int64_t given_id,
              const double *axis_costs) {
    Choice choice;
    double least = INFINITE;
    for (size_t k = 0; k < kinds.size(); k++) {
        const Kind &kind = kinds[k];
        double off = 0.0;
        bool fits = true;
        for (int axis = 0; axis < 3; axis++) {
            const double gap_m = measured[axis] - kind.mean[axis];
            const bool is_longer = gap_m > 0.0;
            const double off_m = is_longer ? gap_m : -gap_m * visible[axis];
            const double most = is_longer ? INFINITE : MAX_SHORT_SIGMAS;
            const double sigmas = std::min(off_m / (is_longer ? kind.longer_m[axis] : kind.shorter_m[axis]), most);
            off += sigmas * sigmas / 2;
            fits &= measured[axis] <= kind.limit[axis];
        }
        double cost = fits ? off + kind.rarity : INFINITE;
        if (given_id >= 0) cost = kind.class_id == given_id ? off : INFINITE;
        cost += axis_costs[k % 2];
        if (k == 0 || cost < least) {
            least = cost;
            choice = {int64_t(k), cost < INFINITE, off};
        }
    }
    return choice;
}

nb::tuple completed_boxes(In2<double> low, In2<double> high, In1<double> angle_rad, In1<double> cos_, In1<double> sin_,
                          In1<double> top_m, In1<double> gap_m, In2<double> lidar_share, In2<double> lidar_xy,
                          In1<int64_t> class_ids, In2<double> mean_m, In2<double> limit_m, In1<double> rarity,
                          In1<int64_t> given_ids, In2<double> axis_costs, double max_slender_share) {
    const size_t clusters = lidar_share.shape(0), lidars = lidar_share.shape(1);
    Out<int64_t> found({clusters});
    Out<double> center_xy({clusters, 2}), sizes({clusters, 3}), yaw_rad({clusters}), misfit({clusters});
    Out<double> center_std_m({clusters, 2}), faces_m2({clusters});
    Out<bool> rides({clusters});
    {
        nb::gil_scoped_release unlocked;
        std::vector<Kind> kinds(class_ids.shape(0));
        for (size_t k = 0; k < kinds.size(); k++) {
            kinds[k].class_id = class_ids.data()[k];
            kinds[k].rarity = rarity.data()[k];
            for (int axis = 0; axis < 3; axis++) {
                const double mean = mean_m.data()[3 * k + axis], limit = limit_m.data()[3 * k + axis];
                kinds[k].mean[axis] = mean;
                kinds[k].limit[axis] = limit;
                kinds[k].longer_m[axis] = std::max((limit - mean) / 2, 1e-9);
                kinds[k].shorter_m[axis] = SHORT_SHARE * mean;
            }
        }
        std::vector<double> towards(2 * lidars);
        for (size_t c = 0; c < clusters; c++) {
            const double cos = cos_.data()[c], sin = sin_.data()[c], top = top_m.data()[c];
            const double *share = lidar_share.data() + c * lidars;
            double extent[2], middle[2], seen[2] = {0.0, 0.0};
            for (int axis = 0; axis < 2; axis++) {
                const double from = low.data()[2 * c + axis], to = high.data()[2 * c + axis];
                extent[axis] = to - from;
                middle[axis] = (to + from) / 2;
            }
            for (size_t lidar = 0; lidar < lidars; lidar++) {
                const double x = lidar_xy.data()[2 * lidar], y = lidar_xy.data()[2 * lidar + 1];
                double *to_lidar = &towards[2 * lidar];
                to_lidar[0] = (cos * x + sin * y) - middle[0];
                to_lidar[1] = (cos * y - sin * x) - middle[1];
                const double square_m2 = to_lidar[0] * to_lidar[0] + to_lidar[1] * to_lidar[1];
                const double distance_m = std::max(std::sqrt(square_m2), 1e-9);
                // The extent along one axis is visible on the side whose normal is the other axis.
                for (int axis = 0; axis < 2; axis++)
                    seen[1 - axis] += share[lidar] * std::abs(to_lidar[axis] / distance_m);
            }

            const double measured[3] = {extent[0], extent[1], top}, visible[3] = {seen[0], seen[1], 1.0};
            const Choice choice = choose(kinds, measured, visible, given_ids.data()[c], axis_costs.data() + 2 * c);
            found[c] = choice.fits ? kinds[choice.row].class_id : -1;
            misfit[c] = choice.misfit;

            const double *mean = kinds[choice.row].mean, *limit = kinds[choice.row].limit;
            const double narrow = std::min(mean[0], mean[1]), wide = std::max(mean[0], mean[1]);
            const bool is_slender = narrow <= max_slender_share * mean[2], is_round = narrow > MAX_RIDER_SHARE * wide;
            const double of_slender = is_round ? PEDESTRIAN_ANCHOR : 0.0, anchored = is_slender ? of_slender : 1.0;
            rides[c] = is_slender && !is_round;
            const double height = top >= WHOLE_SHARE * mean[2] ? top : mean[2];
            // The head of a person may be between two beams, which adds no points.
            sizes(c, 2) = is_slender ? std::max(height, std::min(mean[2], top + gap_m.data()[c])) : height;
            const int turn = choice.row % 2;  // 1: the length lies along the second axis
            double full[2], center[2];
            for (int axis = 0; axis < 2; axis++) {
                const double reach_m = std::max(extent[axis], mean[axis] / 2) / 2;
                double beyond = 0.0, before = 0.0, anchor = 0.0;
                for (size_t lidar = 0; lidar < lidars; lidar++) {
                    // -1: the lidar is beyond the low end, 1: beyond the high end, between: beside the object.
                    const double end = std::min(std::max(towards[2 * lidar + axis] / reach_m, -1.0), 1.0);
                    beyond += end > 0.5 ? share[lidar] : 0.0;
                    before += end < -0.5 ? share[lidar] : 0.0;
                    anchor += share[lidar] * end;
                }
                const bool has_both_ends =
                    std::min(beyond, before) >= BOTH_ENDS_SHARE && extent[axis] >= BOTH_ENDS_WHOLE_SHARE * mean[axis];
                const bool is_whole = has_both_ends || (seen[axis] > 0.5 && extent[axis] >= WHOLE_SHARE * mean[axis]);
                const double missing_m = is_whole && !is_slender ? 0.0 : std::max(mean[axis] - extent[axis], 0.0);
                full[axis] = extent[axis] + missing_m;
                // A grown side errs by the spread of the class; half of that moves the centre.
                const double std_m = missing_m > 0.0 ? std::min((limit[axis] - mean[axis]) / 4, missing_m) : 0.0;
                center_std_m(c, axis ^ turn) = is_slender ? (full[axis] - extent[axis]) / 4 : std_m;
                sizes(c, axis ^ turn) = full[axis];
                const double grown = middle[axis] - anchor * missing_m / 2;
                center[axis] = middle[axis] + anchored * (grown - middle[axis]);
            }
            faces_m2[c] = (seen[0] * full[0] + seen[1] * full[1]) * height;
            center_xy(c, 0) = center[0] * cos - center[1] * sin;
            center_xy(c, 1) = center[0] * sin + center[1] * cos;
            const double yaw = angle_rad.data()[c] + (turn ? PI / 2 : 0.0);
            yaw_rad[c] = yaw > PI / 2 ? yaw - PI : yaw;
        }
    }
    return nb::make_tuple(found.numpy(), center_xy.numpy(), sizes.numpy(), yaw_rad.numpy(), misfit.numpy(),
                          center_std_m.numpy(), faces_m2.numpy(), rides.numpy());
}

// A place in the frame of a box, on the ground.
struct Local {
    double x, y, z;
};

// The 26 numbers of the points in a box with half the size given; see `FEATURES` from `low` on.
void describe(const std::vector<Local> &points, double half_x, double half_y, double *found) {
    const double n = double(points.size()), each = 1.0 / n;
    double mean_x = 0.0, mean_y = 0.0, mean_z = 0.0, low = INFINITE, top = 0.0;
    for (const Local &point : points) {
        mean_x += point.x / n;
        mean_y += point.y / n;
        mean_z += point.z / n;
        low = std::min(low, point.z);
        top = std::max(top, point.z);
        found[4 + steps_below(point.z, LAYERS_M)] += each;
    }
    double xx = 0.0, xy = 0.0, yy = 0.0, zz = 0.0, side = 0.0, side_square = 0.0, inside = 0.0;
    for (const Local &point : points) {
        const double x = point.x - mean_x, y = point.y - mean_y, z = point.z - mean_z;
        xx += x * x / n;
        xy += x * y / n;
        yy += y * y / n;
        zz += z * z / n;
        const double depth = std::abs(std::min(half_x - std::abs(point.x), half_y - std::abs(point.y)));
        side += depth / n;
        side_square += depth * depth / n;
        inside += depth > 0.3 ? each : 0.0;
    }
    // The principal axes seen from above.
    const double half = (xx + yy) / 2, apart = (xx - yy) / 2, gap = std::sqrt(apart * apart + xy * xy);
    const double longer = half + gap, shorter = std::max(half - gap, 0.0);
    double axis_x = xx > yy ? longer - yy : xy, axis_y = xx > yy ? xy : longer - xx;
    const double norm = std::sqrt(axis_x * axis_x + axis_y * axis_y);
    axis_x = norm > 0 ? axis_x / norm : 1.0;
    axis_y = norm > 0 ? axis_y / norm : 0.0;
    double least[4][2], largest[4][2], on_axis = 0.0, scatter = 0.0;
    std::fill(&least[0][0], &least[0][0] + 8, INFINITE);
    std::fill(&largest[0][0], &largest[0][0] + 8, -INFINITE);
    for (const Local &point : points) {
        const double x = point.x - mean_x, y = point.y - mean_y;
        const double places[2] = {x * axis_x + y * axis_y, y * axis_x - x * axis_y};
        on_axis += std::abs(places[1]) < 0.1 ? each : 0.0;
        scatter += places[1] * (point.z - mean_z) / n;
        for (const int64_t row : {steps_below(point.z, PROFILES_M), int64_t(3)}) {  // 3: all heights
            for (int axis = 0; axis < 2; axis++) {
                least[row][axis] = std::min(least[row][axis], places[axis]);
                largest[row][axis] = std::max(largest[row][axis], places[axis]);
            }
        }
    }
    found[0] = low;
    found[1] = mean_z;
    found[2] = top;
    found[3] = std::sqrt(zz);
    found[11] = std::sqrt(shorter);
    found[12] = scatter;
    found[13] = std::sqrt(longer);
    found[14] = largest[3][0] - least[3][0];
    found[15] = largest[3][1] - least[3][1];
    found[16] = on_axis;
    for (int row = 0; row < 3; row++) {
        for (int axis = 0; axis < 2; axis++) {
            const bool is_seen = largest[row][axis] >= least[row][axis];
            found[17 + 2 * row + axis] = is_seen ? largest[row][axis] - least[row][axis] : -0.5;
        }
    }
    found[23] = side;
    found[24] = std::sqrt(std::max(side_square - side * side, 0.0));
    found[25] = inside;
}

nb::tuple box_shapes(In2<double> position, In1<int64_t> starts, In2<double> placed, In2<double> heading,
                     In2<double> sight, double reach_m) {
    const size_t boxes = placed.shape(0);
    Out<double> counts({boxes, 7}), shapes({boxes, 26});
    {
        nb::gil_scoped_release unlocked;
        std::vector<Local> inside;
        for (size_t b = 0; b < boxes; b++) {
            const double *box = placed.data() + 5 * b, *ahead = heading.data() + 2 * b;
            const double *to_lidar = sight.data() + 2 * b;
            const double half_x = box[2] / 2, half_y = box[3] / 2, high = box[4] + MARGIN_M;
            inside.clear();
            for (int64_t i = starts.data()[b]; i < starts.data()[b + 1]; i++) {
                const double *at = position.data() + 3 * i;
                const double dx = at[0] - box[0], dy = at[1] - box[1], z = at[2];
                const double x = ahead[0] * dx + ahead[1] * dy, y = ahead[0] * dy - ahead[1] * dx;
                const double off_x = std::abs(x) - half_x, off_y = std::abs(y) - half_y;
                if (off_x <= MARGIN_M && off_y <= MARGIN_M) {
                    if (z <= high) inside.push_back({x, y, z});
                    else if (z <= high + ABOVE_M) counts(b, 6)++;
                } else if (off_x <= reach_m && off_y <= reach_m && z < 3.0) {
                    if (z > 1.2) counts(b, 5)++;
                    if (off_y <= MARGIN_M) counts(b, 1)++;
                    else if (off_x <= MARGIN_M) counts(b, 2)++;
                    counts(b, x * to_lidar[0] + y * to_lidar[1] > 0 ? 3 : 4)++;
                }
            }
            counts(b, 0) = double(inside.size());
            if (inside.size() >= 3) describe(inside, half_x, half_y, &shapes(b, 0));
        }
    }
    return nb::make_tuple(counts.numpy(), shapes.numpy());
}

void add(nb::module_ &kernels) {
    kernels.def("points_above_ground", &points_above_ground, array("xyz"), array("lidar_index"), array("time_ns"),
                array("rows"), array("plane"), array("relief_m"), array("grid"), array("lidar_xyz"),
                nb::arg("distance_m"), nb::arg("distance_per_m"), nb::arg("above_m"), nb::arg("below_m"));
    kernels.def("completed_boxes", &completed_boxes, array("low"), array("high"), array("angle_rad"), array("cos"),
                array("sin"), array("top_m"), array("gap_m"), array("lidar_share"), array("lidar_xy"),
                array("class_ids"), array("mean_m"), array("limit_m"), array("rarity"), array("given_ids"),
                array("axis_costs"), nb::arg("max_slender_share"));
    kernels.def("box_shapes", &box_shapes, array("position"), array("starts"), array("placed"), array("heading"),
                array("sight"), nb::arg("reach_m"));
}

}  // namespace boxes
