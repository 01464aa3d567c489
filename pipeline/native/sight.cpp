// Whether something nearer to the lidar hides the lower part of a cluster: see `detectors/cluster/detector.py`.
#include "arrays.h"

#include <algorithm>
#include <limits>
#include <vector>

namespace sight {

nb::object hidden_below(In1<int64_t> first, In1<double> distance_m, In1<double> slope, In1<double> height_m,
                        In1<int64_t> sector, In1<double> far_m, In1<double> lidar_height_m, In1<int64_t> starts,
                        double from_m, double max_nearer_share, double min_hidden_share) {
    const size_t clusters = starts.shape(0);
    Out<bool> found({clusters});
    {
        nb::gil_scoped_release unlocked;
        std::vector<int64_t> looked(first.shape(0), -1);
        for (size_t c = 0; c < clusters; c++) {
            const size_t start = starts.data()[c], end = c + 1 < clusters ? starts.data()[c + 1] : sector.shape(0);
            double bottom_m = std::numeric_limits<double>::infinity();
            for (size_t i = start; i < end; i++) bottom_m = std::min(bottom_m, height_m.data()[i]);
            int64_t lines = 0, hidden = 0;
            for (size_t i = start; i < end; i++) {  // the first point in each sector stands for all of them
                const int64_t own = sector.data()[i];
                if (looked[own] == int64_t(c)) continue;
                looked[own] = int64_t(c);
                lines++;
                const double away_m = far_m.data()[i], lidar_m = lidar_height_m.data()[i];
                for (int64_t k = first.data()[own]; k < first.data()[own + 1]; k++) {
                    const double meets_m = lidar_m + slope.data()[k] * away_m;
                    const bool is_nearer = distance_m.data()[k] < max_nearer_share * away_m;
                    if (is_nearer && from_m <= meets_m && meets_m <= bottom_m) {
                        hidden++;
                        break;
                    }
                }
            }
            found[c] = double(hidden) >= min_hidden_share * double(lines);
        }
    }
    return found.numpy();
}

void add(nb::module_ &kernels) {
    kernels.def("hidden_below", &hidden_below, array("first"), array("distance_m"), array("slope"), array("height_m"),
                array("sector"), array("far_m"), array("lidar_height_m"), array("starts"), nb::arg("from_m"),
                nb::arg("max_nearer_share"), nb::arg("min_hidden_share"));
}

}  // namespace sight
