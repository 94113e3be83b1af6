// What Python sees of the kernels: the module `_kernels`, by chapters.
#include <plate/bind.hpp>

namespace plate {

void bind_analysis(nb::module_& m);
void bind_averages(nb::module_& m);
void bind_fit(nb::module_& m);
void bind_force_maps(nb::module_& m);
void bind_limits(nb::module_& m);
void bind_maps(nb::module_& m);
void bind_requests(nb::module_& m);
void bind_rotations(nb::module_& m);
void bind_sinusoids(nb::module_& m);

NB_MODULE(_kernels, m) {
    nb::set_leak_warnings(false);  // of what the interpreter still keeps when it ends
    bind_analysis(m);
    bind_averages(m);
    bind_fit(m);
    bind_force_maps(m);
    bind_limits(m);
    bind_maps(m);
    bind_requests(m);
    bind_rotations(m);
    bind_sinusoids(m);
}

}  // namespace plate
