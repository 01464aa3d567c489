// The module `kernels`: what each file adds to it.
#include "arrays.h"

void add_assignment(nb::module_ &kernels);
void add_boxes(nb::module_ &kernels);
void add_cdr(nb::module_ &kernels);
void add_clusters(nb::module_ &kernels);
void add_curve(nb::module_ &kernels);
void add_ground(nb::module_ &kernels);
void add_lenses(nb::module_ &kernels);
void add_lshape(nb::module_ &kernels);
void add_motion(nb::module_ &kernels);
void add_neighbors(nb::module_ &kernels);
void add_outlines(nb::module_ &kernels);
void add_pillars(nb::module_ &kernels);
void add_regions(nb::module_ &kernels);
void add_relief(nb::module_ &kernels);
void add_sight(nb::module_ &kernels);
void add_visibility(nb::module_ &kernels);

NB_MODULE(kernels, kernels) {
    add_assignment(kernels);
    add_boxes(kernels);
    add_cdr(kernels);
    add_clusters(kernels);
    add_curve(kernels);
    add_ground(kernels);
    add_lenses(kernels);
    add_lshape(kernels);
    add_motion(kernels);
    add_neighbors(kernels);
    add_outlines(kernels);
    add_pillars(kernels);
    add_regions(kernels);
    add_relief(kernels);
    add_sight(kernels);
    add_visibility(kernels);
}
