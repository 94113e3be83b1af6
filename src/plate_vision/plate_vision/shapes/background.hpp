// What is behind the parts of an image: see background.py.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>

#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate {

// Write how far colours (n, CHANNELS) are from others: (n,) [L], 255 at most; of three channels a
// and b have a weight.
template <int CHANNELS>
[[gnu::always_inline]] inline void deviation_of(const uint8_t* __restrict lab,
                                                const uint8_t* __restrict bare, float weight,
                                                uint8_t* __restrict out, int count) {
#pragma omp simd
    for (int i = 0; i < count; i++) {
        const int light = lab[CHANNELS * i] - bare[CHANNELS * i];
        float square = light * light;
        if constexpr (CHANNELS == 3) {
            const int a = lab[3 * i + 1] - bare[3 * i + 1], b = lab[3 * i + 2] - bare[3 * i + 2];
            square += weight * static_cast<float>(a * a + b * b);
        }
        out[i] = static_cast<int>(std::min(std::sqrt(square) + 0.5f, 255.f));
    }
}

PLATE_WIDE inline void deviation_of_greys(const uint8_t* grey, const uint8_t* bare, uint8_t* out,
                                          int count) {
    deviation_of<1>(grey, bare, 0, out, count);
}

PLATE_WIDE inline void deviation_of_colours(const uint8_t* lab, const uint8_t* bare, float weight,
                                            uint8_t* out, int count) {
    deviation_of<3>(lab, bare, weight, out, count);
}

}  // namespace plate
