// The module `kernels`: what each file adds to it.
#include "arrays.h"

void add_assignment(nb::module_ &kernels);
void add_boxes(nb::module_ &kernels);
void add_clusters(nb::module_ &kernels);
void add_lshape(nb::module_ &kernels);
void add_sight(nb::module_ &kernels);

NB_MODULE(kernels, kernels) {
    add_assignment(kernels);
    add_boxes(kernels);
    add_clusters(kernels);
    add_lshape(kernels);
    add_sight(kernels);
}
