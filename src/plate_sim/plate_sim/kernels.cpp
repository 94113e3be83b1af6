// Python module `_kernels`. The module contains the bindings of all compiled kernels.
#include <plate/bind.hpp>

namespace plate {

void bind_plate(nb::module_& m);
void bind_friction(nb::module_& m);
void bind_camera(nb::module_& m);
void bind_world(nb::module_& m);
void bind_device(nb::module_& m);

NB_MODULE(_kernels, m) {
    bind_plate(m);
    bind_friction(m);
    bind_camera(m);
    bind_world(m);
    bind_device(m);
}

}  // namespace plate
