// The module `kernels`: what each file adds to it. All are one unit, since reading the headers of nanobind takes longer
// than compiling most of them.
#include "assignment.cpp"
#include "boxes.cpp"
#include "cdr.cpp"
#include "clusters.cpp"
#include "ground.cpp"
#include "lenses.cpp"
#include "lshape.cpp"
#include "motion.cpp"
#include "neighbors.cpp"
#include "outlines.cpp"
#include "pillars.cpp"
#include "regions.cpp"
#include "relief.cpp"
#include "visibility.cpp"

NB_MODULE(kernels, kernels) {
    for (auto *add : {assignment::add, boxes::add, cdr::add, clusters::add, ground::add, lenses::add, lshape::add,
                      motion::add, neighbors::add, outlines::add, pillars::add, regions::add, relief::add, visibility::add})
        add(kernels);
}
