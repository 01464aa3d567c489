// Exact distances to nearest neighbours, for all points of a cloud at once.
//
// The points are sorted along a curve and cut into runs of neighbours, with a box around each run and around each block
// of runs. The points of a run look for neighbours together: boxes and points that are farther away than the known
// neighbours are left out. The innermost loops go through the points of a run, or through boxes, in vectors.
#include "arrays.h"
#include "curve.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

namespace neighbors {

constexpr int RUN = 32;    // points of a run, and runs of a block
constexpr int RANKS = 10;  // neighbours inserted in one pass: `outliers.NEIGHBORS`

// The square of all distances whose square is not below it.
constexpr float LARGEST = std::numeric_limits<float>::max();

// A number for each point of a run, or for each run of a block.
using Row = float[RUN];

struct Run {
    Row axes[3];
};

struct Box {
    float low[3], high[3];
};

// Boxes of the runs of a block, and the one around them.
struct Block {
    Row low[3], high[3];
    Box whole;
};

// A cloud in runs and blocks.
struct Cloud {
    std::vector<Run> points;
    std::vector<Box> boxes;  // around each run
    std::vector<Block> blocks;
    int64_t count;  // of the points; those of the last runs are repeats of the last one
};

// Vectors of numbers: four that every processor takes at once, eight where there is AVX2.
typedef float Four __attribute__((vector_size(16)));
typedef float Eight __attribute__((vector_size(32)));

// How many vectors a row is.
template <class Lanes> constexpr int PARTS = sizeof(Row) / sizeof(Lanes);

template <class Lanes> LIDCAM_PART Lanes part_of(const Row &row, int part) {
    Lanes lanes;
    std::memcpy(&lanes, row + part * (RUN / PARTS<Lanes>), sizeof lanes);
    return lanes;
}

template <class Lanes> LIDCAM_PART void set_part(Row &row, int part, Lanes lanes) {
    std::memcpy(row + part * (RUN / PARTS<Lanes>), &lanes, sizeof lanes);
}

template <class Mask> LIDCAM_PART bool is_any(Mask mask) {
    int64_t pairs[sizeof(Mask) / sizeof(int64_t)], any = 0;
    std::memcpy(pairs, &mask, sizeof pairs);
    for (const int64_t pair : pairs) any |= pair;
    return any != 0;
}

template <class T> LIDCAM_PART T smaller(T a, T b) { return a < b ? a : b; }

template <class T> LIDCAM_PART T larger(T a, T b) { return a > b ? a : b; }

// The square of how far [low, high] is from [other_low, other_high] along an axis.
template <class T> LIDCAM_PART T beyond(T low, T high, float other_low, float other_high) {
    const T gap = larger<T>(larger<T>(low - other_high, other_low - high), T{});
    return gap * gap;
}

LIDCAM_PART float gap_of(const Box &box, const Box &other) {
    float gap = beyond(box.low[0], box.high[0], other.low[0], other.high[0]);
    gap += beyond(box.low[1], box.high[1], other.low[1], other.high[1]);
    return gap + beyond(box.low[2], box.high[2], other.low[2], other.high[2]);
}

// The squared distances of some boxes from another one.
template <class Lanes> LIDCAM_PART Lanes gaps_of(const Row *low, const Row *high, int part, const Box &box) {
    Lanes gaps{};
    for (int axis = 0; axis < 3; axis++)
        gaps += beyond<Lanes>(part_of<Lanes>(low[axis], part), part_of<Lanes>(high[axis], part), box.low[axis],
                              box.high[axis]);
    return gaps;
}

// Whether a box is nearer to one of the points than `farthest` of it, squared.
template <class Lanes> LIDCAM_PART bool is_any_nearer(const Run &own, const Box &box, const Row &farthest) {
    auto nearer = Lanes{} < Lanes{};
    for (int part = 0; part < PARTS<Lanes>; part++)
        nearer |= gaps_of<Lanes>(own.axes, own.axes, part, box) < part_of<Lanes>(farthest, part);
    return is_any(nearer);
}

// Compares the points of a run with those of another one. `nearest`: zeros, then the least square of each point, the
// second, ...; `limit`: the largest of the last ones asked for. Returns what this is then.
template <class Lanes>
LIDCAM_PART float compared(const Cloud &cloud, int64_t run, int64_t other, Row *nearest, int64_t neighbors,
                           float limit) {
    const Run &own = cloud.points[run], &others = cloud.points[other];
    const Row &farthest = nearest[neighbors];
    const int64_t count = std::min<int64_t>(RUN, cloud.count - other * RUN), passes = (neighbors + RANKS - 1) / RANKS;
    Row gaps, squares;
    for (int part = 0; part < PARTS<Lanes>; part++)
        set_part(gaps, part, gaps_of<Lanes>(others.axes, others.axes, part, cloud.boxes[run]));
    for (int64_t j = 0; j < count; j++) {
        if (!(gaps[j] < limit)) continue;
        auto nearer = Lanes{} < Lanes{};
        for (int part = 0; part < PARTS<Lanes>; part++) {
            const Lanes dx = part_of<Lanes>(own.axes[0], part) - others.axes[0][j];
            const Lanes dy = part_of<Lanes>(own.axes[1], part) - others.axes[1][j];
            const Lanes dz = part_of<Lanes>(own.axes[2], part) - others.axes[2][j];
            const Lanes square = dx * dx + dy * dy + dz * dz;
            nearer |= square < part_of<Lanes>(farthest, part);
            set_part(squares, part, square);
        }
        if (!is_any(nearer)) continue;
        if (other == run) squares[j] = LARGEST;  // no point is its own neighbour
        for (int64_t pass = passes - 1; pass >= 0; pass--) {
            Row *rows = nearest + pass * RANKS;
            for (int part = 0; part < PARTS<Lanes>; part++) {
                const Lanes square = part_of<Lanes>(squares, part);
                Lanes here = part_of<Lanes>(rows[RANKS], part);
                for (int rank = RANKS; rank > 0; rank--) {
                    const Lanes before = part_of<Lanes>(rows[rank - 1], part);
                    set_part(rows[rank], part, larger<Lanes>(before, smaller<Lanes>(here, square)));
                    here = before;
                }
            }
        }
    }
    float highest = 0;
    for (int i = 0; i < RUN; i++) highest = larger(highest, farthest[i]);
    return highest;
}

// Writes the mean distance of each point to its nearest neighbours, those of whole runs.
template <class Lanes> LIDCAM_PART void find_means(const Cloud &cloud, int64_t neighbors, float *means) {
    const int64_t runs = (cloud.count + RUN - 1) / RUN, passes = (neighbors + RANKS - 1) / RANKS;
    const std::unique_ptr<Row[]> nearest(new Row[passes * RANKS + 1]());
    Row gaps;
    for (int64_t run = 0; run < runs; run++) {
        const Box &box = cloud.boxes[run];
        float limit = LARGEST;
        std::fill(nearest[1], nearest[passes * RANKS] + RUN, LARGEST);
        for (const int64_t other : {run, run - 1, run + 1})  // near on the curve is near in space as a rule
            if (other >= 0 && other < runs) limit = compared<Lanes>(cloud, run, other, nearest.get(), neighbors, limit);
        for (size_t block = 0; block < cloud.blocks.size(); block++) {
            const Block &others = cloud.blocks[block];
            if (gap_of(others.whole, box) >= limit) continue;
            for (int part = 0; part < PARTS<Lanes>; part++)
                set_part(gaps, part, gaps_of<Lanes>(others.low, others.high, part, box));
            for (int i = 0; i < RUN; i++) {
                const int64_t other = int64_t(block) * RUN + i;
                if (!(gaps[i] < limit) || std::abs(other - run) <= 1) continue;
                if (is_any_nearer<Lanes>(cloud.points[run], cloud.boxes[other], nearest[neighbors]))
                    limit = compared<Lanes>(cloud, run, other, nearest.get(), neighbors, limit);
            }
        }
        double totals[RUN] = {};
        for (int64_t rank = 1; rank <= neighbors; rank++)
            for (int i = 0; i < RUN; i++) totals[i] += std::sqrt(nearest[rank][i]);
        for (int i = 0; i < RUN; i++) means[run * RUN + i] = float(totals[i] / double(neighbors));
    }
}

#if defined(LIDCAM_CLONED)
__attribute__((target("avx2"))) void find_means_by_eight(const Cloud &cloud, int64_t neighbors, float *means) {
    find_means<Eight>(cloud, neighbors, means);
}
#endif

void find_means(const Cloud &cloud, int64_t neighbors, float *means) {
#if defined(LIDCAM_CLONED)
    if (__builtin_cpu_supports("avx2")) return find_means_by_eight(cloud, neighbors, means);
#endif
    find_means<Four>(cloud, neighbors, means);
}

// As PCL rounds: squares of distances, their sums and roots in float32, the sum over the neighbours, nearest first, in
// float64.
nb::object mean_neighbor_distance_m(In2<float> xyz, int64_t neighbors) {
    const int64_t count = xyz.shape(0);
    Out<float> out({size_t(count)}, unset);
    {
        nb::gil_scoped_release unlocked;
        std::vector<float> rows(3 * count);
        for (int64_t i = 0; i < count; i++)
            for (int axis = 0; axis < 3; axis++) rows[axis * count + i] = xyz.data()[3 * i + axis];
        std::vector<int64_t> order(count);
        const float *first = rows.data();
        if (count > 0) curve::order_along_curve(first, first + count, first + 2 * count, count, order.data());

        const int64_t blocks = (count + RUN * RUN - 1) / (RUN * RUN), runs = blocks * RUN;
        Cloud cloud{std::vector<Run>(runs), std::vector<Box>(runs), std::vector<Block>(blocks), count};
        for (int64_t run = 0; run < runs; run++) {
            Block &block = cloud.blocks[run / RUN];
            Box &box = cloud.boxes[run];
            const int64_t of_block = run % RUN;
            for (int axis = 0; axis < 3; axis++) {
                const float *along = first + axis * count;
                Row &own = cloud.points[run].axes[axis];
                for (int i = 0; i < RUN; i++) own[i] = along[order[std::min<int64_t>(run * RUN + i, count - 1)]];
                box.low[axis] = block.low[axis][of_block] = *std::min_element(own, own + RUN);
                box.high[axis] = block.high[axis][of_block] = *std::max_element(own, own + RUN);
            }
            if (of_block == 0) block.whole = box;
            for (int axis = 0; axis < 3; axis++) {
                block.whole.low[axis] = smaller(block.whole.low[axis], box.low[axis]);
                block.whole.high[axis] = larger(block.whole.high[axis], box.high[axis]);
            }
        }
        std::vector<float> means(runs * RUN);
        find_means(cloud, neighbors, means.data());
        for (int64_t i = 0; i < count; i++) out[order[i]] = means[i];
    }
    return out.numpy();
}

void add(nb::module_ &kernels) {
    kernels.def("mean_neighbor_distance_m", &mean_neighbor_distance_m, array("xyz"), nb::arg("neighbors"));
}

}  // namespace neighbors
