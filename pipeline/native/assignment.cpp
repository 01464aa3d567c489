// Assignment of rows to columns with the smallest sum of costs.
#include "arrays.h"

#include <limits>
#include <utility>
#include <vector>

namespace assignment {

// Shortest augmenting paths: Crouse, On implementing 2D rectangular assignment algorithms, IEEE TAES 52(4), 2016.
nb::object columns_of_rows(In2<double> costs) {
    const int64_t row_count = costs.shape(0), column_count = costs.shape(1);
    Out<int64_t> column_of({size_t(row_count)});
    {
        nb::gil_scoped_release unlocked;
        const double *cost = costs.data();
        const double infinite = std::numeric_limits<double>::infinity();
        std::vector<double> row_price(row_count), column_price(column_count), shortest(column_count);
        std::vector<int64_t> row_of(column_count, -1), path(column_count), remaining(column_count);
        std::vector<char> is_row_reached(row_count), is_column_reached(column_count);
        for (int64_t row = 0; row < row_count; row++) column_of[row] = -1;
        for (int64_t added = 0; added < row_count; added++) {
            shortest.assign(column_count, infinite);
            is_row_reached.assign(row_count, 0);
            is_column_reached.assign(column_count, 0);
            for (int64_t place = 0; place < column_count; place++) remaining[place] = column_count - place - 1;
            int64_t left = column_count, row = added, sink = -1;
            double length = 0;
            while (sink < 0) {
                is_row_reached[row] = 1;
                double lowest = infinite;
                int64_t nearest = 0;
                for (int64_t place = 0; place < left; place++) {
                    const int64_t column = remaining[place];
                    const double through = length + cost[row * column_count + column] - row_price[row] - column_price[column];
                    if (through < shortest[column]) {
                        path[column] = row;
                        shortest[column] = through;
                    }
                    if (shortest[column] < lowest || (shortest[column] == lowest && row_of[column] < 0)) {
                        lowest = shortest[column];
                        nearest = place;
                    }
                }
                length = lowest;
                const int64_t column = remaining[nearest];
                if (row_of[column] < 0) sink = column;
                else row = row_of[column];
                is_column_reached[column] = 1;
                remaining[nearest] = remaining[--left];
            }
            row_price[added] += length;
            for (int64_t r = 0; r < row_count; r++)
                if (is_row_reached[r] && r != added) row_price[r] += length - shortest[column_of[r]];
            for (int64_t c = 0; c < column_count; c++)
                if (is_column_reached[c]) column_price[c] -= length - shortest[c];
            for (int64_t column = sink, r = -1; r != added;) {
                r = path[column];
                row_of[column] = r;
                std::swap(column_of[r], column);
            }
        }
    }
    return column_of.numpy();
}

void add(nb::module_ &kernels) { kernels.def("columns_of_rows", &columns_of_rows, array("costs")); }

}  // namespace assignment
