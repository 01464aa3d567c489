// The module `kernels`: what each file adds to it.
#include "arrays.h"

void add_assignment(nb::module_ &kernels);

NB_MODULE(kernels, kernels) {
    add_assignment(kernels);
}
