// Exact distances to nearest neighbours, for all points of a cloud at once.
//
// The points are sorted along a curve and cut into runs of neighbours, with a box around each run and around each block
// of runs. The points of a run look for neighbours together: boxes and points that are farther away than the known
// neighbours are left out. The innermost loops go through the points of a run, or through boxes, so that the compiler
// makes vectors of them.
#include "arrays.h"
#include "curve.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <vector>

namespace {

constexpr int RUN = 32;    // points of a run, and runs of a block
constexpr int RANKS = 10;  // neighbours inserted in one pass: `outliers.NEIGHBORS`

// The square of all distances whose square is not below it.
constexpr float LARGEST = std::numeric_limits<float>::max();

// Numbers of one register. Not aligned: GCC 12 aligns it to 32 bytes in one clone of a function and to 16 in the other.
#if defined(__x86_64__)
constexpr int LANES = 8;
#else
constexpr int LANES = 4;
#endif
constexpr int PARTS = RUN / LANES;
typedef float Lanes __attribute__((vector_size(4 * LANES), aligned(4)));
typedef int32_t Mask __attribute__((vector_size(4 * LANES), aligned(4)));

// A number for each point of a run, or for each run of a block.
struct Row {
    Lanes parts[PARTS];

    const float *begin() const { return reinterpret_cast<const float *>(parts); }
    float *begin() { return reinterpret_cast<float *>(parts); }
};

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

template <class T> LIDCAM_PART T smaller(T a, T b) { return a < b ? a : b; }

template <class T> LIDCAM_PART T larger(T a, T b) { return a > b ? a : b; }

// The square of how far [low, high] is from [other_low, other_high] along an axis.
template <class T> LIDCAM_PART T beyond(T low, T high, float other_low, float other_high) {
    const T gap = larger<T>(larger<T>(low - other_high, other_low - high), T{});
    return gap * gap;
}

// The squared distance of boxes from another one.
template <class T> LIDCAM_PART T gap_of(const T (&low)[3], const T (&high)[3], const Box &box) {
    T gap = beyond(low[0], high[0], box.low[0], box.high[0]);
    gap += beyond(low[1], high[1], box.low[1], box.high[1]);
    return gap + beyond(low[2], high[2], box.low[2], box.high[2]);
}

LIDCAM_PART Lanes gap_of(const Row (&low)[3], const Row (&high)[3], int part, const Box &box) {
    const Lanes lows[3] = {low[0].parts[part], low[1].parts[part], low[2].parts[part]};
    const Lanes highs[3] = {high[0].parts[part], high[1].parts[part], high[2].parts[part]};
    return gap_of(lows, highs, box);
}

LIDCAM_PART bool is_any(Mask mask) {
    int64_t bits[LANES / 2];
    std::memcpy(bits, &mask, sizeof bits);
    int64_t any = 0;
    for (const int64_t pair : bits) any |= pair;
    return any != 0;
}

// Whether a box is nearer to one of the points than `farthest` of it, squared.
LIDCAM_PART bool is_any_nearer(const Run &own, const Box &box, const Row &farthest) {
    Mask nearer = {};
    for (int part = 0; part < PARTS; part++) nearer |= gap_of(own.axes, own.axes, part, box) < farthest.parts[part];
    return is_any(nearer);
}

// Compares the points of a run with those of another one; returns the largest of `farthest` then.
LIDCAM_PART float compared(const Run &own, const Box &box, const Run &others, int64_t count, bool is_same, float limit,
                           Row *nearest, int64_t passes, const Row &farthest) {
    Row gaps, squares;
    for (int part = 0; part < PARTS; part++) gaps.parts[part] = gap_of(others.axes, others.axes, part, box);
    for (int64_t j = 0; j < count; j++) {
        if (!(gaps.begin()[j] < limit)) continue;
        const float x = others.axes[0].begin()[j], y = others.axes[1].begin()[j], z = others.axes[2].begin()[j];
        Mask nearer = {};
        for (int part = 0; part < PARTS; part++) {
            const Lanes dx = own.axes[0].parts[part] - x;
            const Lanes dy = own.axes[1].parts[part] - y;
            const Lanes dz = own.axes[2].parts[part] - z;
            squares.parts[part] = dx * dx + dy * dy + dz * dz;
            nearer |= squares.parts[part] < farthest.parts[part];
        }
        if (!is_any(nearer)) continue;
        if (is_same) squares.begin()[j] = LARGEST;  // no point is its own neighbour
        for (int64_t pass = passes - 1; pass >= 0; pass--) {
            Row *rows = nearest + pass * RANKS;
            for (int part = 0; part < PARTS; part++) {
                const Lanes square = squares.parts[part];
                Lanes here = rows[RANKS].parts[part];
                for (int rank = RANKS; rank > 0; rank--) {
                    const Lanes before = rows[rank - 1].parts[part];
                    rows[rank].parts[part] = larger<Lanes>(before, smaller<Lanes>(here, square));
                    here = before;
                }
            }
        }
    }
    float highest = 0;
    for (int i = 0; i < RUN; i++) highest = larger(highest, farthest.begin()[i]);
    return highest;
}

// Writes the mean distance of each point to its nearest neighbours, those of whole runs.
LIDCAM_HOT void find_means(const Run *points, const Box *boxes, const Block *blocks, int64_t block_count, int64_t count,
                           int64_t neighbors, Row *nearest, float *means) {
    // `nearest`: zeros, then the least square of each point of a run, the second, ...
    const int64_t runs = (count + RUN - 1) / RUN, passes = (neighbors + RANKS - 1) / RANKS;
    const Row &farthest = nearest[neighbors];
    Row gaps;
    double totals[RUN];
    for (int64_t run = 0; run < runs; run++) {
        const Run &own = points[run];
        const Box &box = boxes[run];
        float limit = LARGEST;
        std::fill(nearest[1].begin(), nearest[passes * RANKS + 1].begin(), LARGEST);
        for (const int64_t other : {run, run - 1, run + 1}) {  // near on the curve is near in space as a rule
            if (other < 0 || other >= runs) continue;
            const int64_t there = std::min<int64_t>(RUN, count - other * RUN);
            limit = compared(own, box, points[other], there, other == run, limit, nearest, passes, farthest);
        }
        for (int64_t block = 0; block < block_count; block++) {
            const Block &others = blocks[block];
            if (gap_of(others.whole.low, others.whole.high, box) >= limit) continue;
            for (int part = 0; part < PARTS; part++) gaps.parts[part] = gap_of(others.low, others.high, part, box);
            for (int i = 0; i < RUN; i++) {
                const int64_t other = block * RUN + i;
                if (!(gaps.begin()[i] < limit) || std::abs(other - run) <= 1) continue;
                if (!is_any_nearer(own, boxes[other], farthest)) continue;
                const int64_t there = std::min<int64_t>(RUN, count - other * RUN);
                limit = compared(own, box, points[other], there, false, limit, nearest, passes, farthest);
            }
        }
        std::fill(totals, totals + RUN, 0.0);
        for (int64_t rank = 1; rank <= neighbors; rank++)
            for (int i = 0; i < RUN; i++) totals[i] += std::sqrt(nearest[rank].begin()[i]);
        for (int i = 0; i < RUN; i++) means[run * RUN + i] = float(totals[i] / double(neighbors));
    }
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
        if (count > 0) order_along_curve(first, first + count, first + 2 * count, count, order.data());

        const int64_t block_count = (count + RUN * RUN - 1) / (RUN * RUN), runs = block_count * RUN;
        std::vector<Run> points(runs);
        std::vector<Box> boxes(runs);
        std::vector<Block> blocks(block_count);
        for (int64_t run = 0; run < runs; run++) {
            Block &block = blocks[run / RUN];
            Box &box = boxes[run];
            const int of_block = int(run % RUN);
            for (int axis = 0; axis < 3; axis++) {
                const float *along = first + axis * count;
                float *own = points[run].axes[axis].begin();
                for (int i = 0; i < RUN; i++) own[i] = along[order[std::min<int64_t>(run * RUN + i, count - 1)]];
                box.low[axis] = block.low[axis].begin()[of_block] = *std::min_element(own, own + RUN);
                box.high[axis] = block.high[axis].begin()[of_block] = *std::max_element(own, own + RUN);
            }
            if (of_block == 0) block.whole = box;
            for (int axis = 0; axis < 3; axis++) {
                block.whole.low[axis] = smaller(block.whole.low[axis], box.low[axis]);
                block.whole.high[axis] = larger(block.whole.high[axis], box.high[axis]);
            }
        }
        const int64_t passes = (neighbors + RANKS - 1) / RANKS;
        std::vector<Row> nearest(passes * RANKS + 1);
        std::vector<float> means(runs * RUN);
        find_means(points.data(), boxes.data(), blocks.data(), block_count, count, neighbors, nearest.data(),
                   means.data());
        for (int64_t i = 0; i < count; i++) out[order[i]] = means[i];
    }
    return out.numpy();
}

}  // namespace

void add_neighbors(nb::module_ &kernels) {
    kernels.def("mean_neighbor_distance_m", &mean_neighbor_distance_m, array("xyz"), nb::arg("neighbors"));
}
