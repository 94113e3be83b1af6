// Arrays of Python as kernels of vision take them; what would be read outside memory is refused.
#pragma once
#include <stdexcept>

#include <plate/bind.hpp>

#include "plate/light.hpp"

namespace plate {

template <class T, nb::ssize_t N>
using In = Array<const T, N>;

inline void require(bool right, const char* what) {
    if (!right) throw std::invalid_argument(what);
}

// Whether arrays have the same size along their first two axes.
template <class First, class... Others>
bool same_pixels(const First& first, const Others&... others) {
    return ((others.shape(0) == first.shape(0) && others.shape(1) == first.shape(1)) && ...);
}

inline LitPlate lit_plate(const In<uint8_t, 2>& grey, const In<float, 1>& light,
                          const In<bool, 2>& usable) {
    require(light.shape(0) == 9 && same_pixels(grey, usable),
            "shapes: grey and usable (H, W), light (9,)");
    return {view(grey), view(light), view(usable)};
}

}  // namespace plate
