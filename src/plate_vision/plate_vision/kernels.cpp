// Python module `_kernels`: the bindings of all vision kernels.
#include <plate/bind.hpp>

namespace plate {

void bind_plate(nb::module_& m);
void bind_discs(nb::module_& m);
void bind_shapes(nb::module_& m);

NB_MODULE(_kernels, m) {
    bind_plate(m);
    bind_discs(m);
    bind_shapes(m);
}

}  // namespace plate
