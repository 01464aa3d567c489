// The module `kernels`: what each file adds to it.
#include "arrays.h"

using AddKernels = void(nb::module_ &);
AddKernels add_assignment, add_boxes, add_cdr, add_clusters, add_ground, add_lenses, add_lshape, add_motion,
    add_neighbors, add_outlines, add_pillars, add_regions, add_relief, add_sight, add_visibility;

NB_MODULE(kernels, kernels) {
    for (AddKernels *add : {add_assignment, add_boxes, add_cdr, add_clusters, add_ground, add_lenses, add_lshape,
                            add_motion, add_neighbors, add_outlines, add_pillars, add_regions, add_relief, add_sight,
                            add_visibility})
        add(kernels);
}
