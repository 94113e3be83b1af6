// Python module `_kernels`. The file `kernels.cpp` in each folder contains the bindings of the
// folder's kernels.
#include <plate/bind.hpp>

namespace plate {

void bind_average_rotations(nb::module_& m);
void bind_average_sinusoids(nb::module_& m);
void bind_cycle_map(nb::module_& m);
void bind_fit(nb::module_& m);
void bind_force_maps(nb::module_& m);
void bind_goal(nb::module_& m);
void bind_library(nb::module_& m);
void bind_limits(nb::module_& m);
void bind_rotations(nb::module_& m);
void bind_sinusoids(nb::module_& m);
void bind_unreachable(nb::module_& m);

NB_MODULE(_kernels, m) {
    nb::set_leak_warnings(false);  // the interpreter may still hold objects at exit
    bind_average_rotations(m);
    bind_average_sinusoids(m);
    bind_cycle_map(m);
    bind_fit(m);
    bind_force_maps(m);
    bind_goal(m);
    bind_library(m);
    bind_limits(m);
    bind_rotations(m);
    bind_sinusoids(m);
    bind_unreachable(m);
}

}  // namespace plate
