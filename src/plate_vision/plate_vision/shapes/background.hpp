// C++ kernels of background.py, which models the bare plate behind the parts of an image.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>

#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate {

// Write the deviations (n,) between the colours `lab` and `bare` (n, CHANNELS) to `out`, clipped to
// 255. The deviations have the unit of the lightness L (0 to 255). With three channels, the squared
// differences in a and b are multiplied by `weight`.
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

// L (0 to 255) plus this offset is proportional to the cube root of the luminance. The offset is
// equivalent to 16 for the L of CIELAB, which is from 0 to 100.
constexpr float LIGHTNESS_0 = 40.8f;

// A rectangle in an image: columns x0 to x1 - 1, and rows y0 to y1 - 1.
struct ImageBox {
    int x0, y0, x1, y1;
};

// Compute one image row of the bare plate under another light. The light multiplies all colours by
// a factor, and shifts a and b. Each of these three values is a quadratic function of u = `first` +
// x `step`. Each row of `along` contains the coefficients of 1, u and u^2 for one of these values.
template <int CHANNELS>
[[gnu::always_inline]] inline void relight_row(const uint8_t* __restrict bare,
                                               uint8_t* __restrict out, int count, float first,
                                               float step, const float (&along)[3][3]) {
    constexpr float BLACK = CHANNELS == 3 ? LIGHTNESS_0 : 0;
#pragma omp simd
    for (int x = 0; x < count; x++) {
        const float u = first + step * static_cast<float>(x);
        const float factor = along[0][0] + u * (along[0][1] + u * along[0][2]);
        const float light = (bare[CHANNELS * x] + BLACK) * factor - BLACK + 0.5f;
        out[CHANNELS * x] = static_cast<int>(std::min(std::max(light, 0.f), 255.f));
        if constexpr (CHANNELS == 3)
            for (int c = 1; c < 3; c++) {
                const float shift = along[c][0] + u * (along[c][1] + u * along[c][2]);
                const float tint = (bare[3 * x + c] - 128.f) * factor + 128.5f + shift;
                out[3 * x + c] = static_cast<int>(std::min(std::max(tint, 0.f), 255.f));
            }
    }
}

PLATE_WIDE inline void relight_greys(const uint8_t* bare, uint8_t* out, int count, float first,
                                     float step, const float (&along)[3][3]) {
    relight_row<1>(bare, out, count, first, step, along);
}

PLATE_WIDE inline void relight_colours(const uint8_t* bare, uint8_t* out, int count, float first,
                                       float step, const float (&along)[3][3]) {
    relight_row<3>(bare, out, count, first, step, along);
}

// Compute the colours of the bare plate (h, w, c) under another light, within a box. `surface` (6,
// c) contains the coefficients of 1, u, v, u^2, u v and v^2 for the factor and for the shifts of a
// and b. (u, v) are scaled image coordinates. The first two numbers of `place` are the image point
// [px] with u = v = 0. The third number converts pixels to units of u and v.
inline void relight(View<const uint8_t, 3> bare, View<const float, 2> surface, const float* place,
                    const ImageBox& box, View<uint8_t, 3> out) {
    const int channels = bare.size(2);
    for (int y = box.y0; y < box.y1; y++) {
        const float v = (y - place[1]) * place[2];
        float along[3][3] = {};
        for (int c = 0; c < channels; c++) {
            along[c][0] = surface(0, c) + v * (surface(2, c) + v * surface(5, c));
            along[c][1] = surface(1, c) + v * surface(4, c);
            along[c][2] = surface(3, c);
        }
        const float first = (box.x0 - place[0]) * place[2];
        const uint8_t* from = bare[y] + channels * box.x0;
        uint8_t* to = out[y] + channels * box.x0;
        if (channels == 1)
            relight_greys(from, to, box.x1 - box.x0, first, place[2], along);
        else
            relight_colours(from, to, box.x1 - box.x0, first, place[2], along);
    }
}

}  // namespace plate
