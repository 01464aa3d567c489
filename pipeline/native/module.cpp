// The module `kernels`: what each file adds to it.
#include "arrays.h"

void add_assignment(nb::module_ &kernels);
void add_cdr(nb::module_ &kernels);
void add_lenses(nb::module_ &kernels);
void add_outlines(nb::module_ &kernels);
void add_pillars(nb::module_ &kernels);
void add_regions(nb::module_ &kernels);
void add_visibility(nb::module_ &kernels);

NB_MODULE(kernels, kernels) {
    add_assignment(kernels);
    add_cdr(kernels);
    add_lenses(kernels);
    add_outlines(kernels);
    add_pillars(kernels);
    add_regions(kernels);
    add_visibility(kernels);
}
