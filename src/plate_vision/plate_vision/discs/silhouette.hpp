// The silhouette of a part at one place of the image: see silhouette.py.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>

#include <plate/length.hpp>

namespace plate {

// One row of `SILHOUETTE` (silhouette.py). `across` (2, 2) transforms image offsets [px] from the
// part's place to the disc's frame, in which the contour at the plate is a circle. The top is a
// circle of `growth` times that radius around `lean_px`.
struct Silhouette {
    double across[2][2], radius_px, lean_px[2], growth;

    // Transforms a vector (wx, wy) from the disc's frame to an image offset (x, y) [px].
    void to_image(double wx, double wy, double& x, double& y) const {
        const double area = across[0][0] * across[1][1] - across[0][1] * across[1][0];
        x = (across[1][1] * wx - across[0][1] * wy) / area;
        y = (across[0][0] * wy - across[1][0] * wx) / area;
    }
    bool is_finite() const {
        const double area = across[0][0] * across[1][1] - across[0][1] * across[1][0];
        return std::abs(area) > 1e-6 && std::isfinite(reach());
    }
    // The image of a flat part is an ellipse with half axes a, b. The function returns (a^2 - b^2)
    // / (a^2 + b^2) times the cosine and the sine of twice the direction of a.
    std::array<double, 2> flatness() const {
        // The second moments of the ellipse are proportional to A^-1 A^-T with A = `across`.
        const double a = across[0][0], b = across[0][1], c = across[1][0], d = across[1][1];
        const double xx = d * d + b * b, yy = a * a + c * c, xy = -(c * d + a * b);
        return {(xx - yy) / (xx + yy), 2 * xy / (xx + yy)};
    }
    bool is_high() const { return growth != 1 || lean_px[0] != 0 || lean_px[1] != 0; }
    double lean_length() const { return length_of(lean_px[0], lean_px[1]); }

    // Maximum length in the image [px] of a vector with length 1 px in the disc's frame.
    double stretch() const {
        // Reciprocal of the smallest singular value.
        const double a = across[0][0], b = across[0][1], c = across[1][0], d = across[1][1];
        const double half = 0.5 * (a * a + b * b + c * c + d * d), area = a * d - b * c;
        const double least = std::sqrt(half - std::sqrt(std::max(half * half - area * area, 0.0)));
        return 1 / std::max(least, 1e-3);
    }

    // Upper limit for the distance between the part's place and any point of its silhouette in the
    // image [px].
    double reach() const {
        return (std::max(growth, 1.0) * radius_px + lean_length()) * stretch();
    }

    // Compute the offset (x, y) [px] of a contour point from the part's place. The outward normal
    // of the contour at this point has the direction (nx, ny) in the image.
    void contour(double nx, double ny, double& x, double& y) const {
        // Normals transform by the inverse transpose, up to their length.
        double wx = across[1][1] * nx - across[1][0] * ny;
        double wy = across[0][0] * ny - across[0][1] * nx;
        const double length = std::max(std::sqrt(wx * wx + wy * wy), 1e-12);
        wx /= length, wy /= length;
        const bool top = wx * lean_px[0] + wy * lean_px[1] > 0;
        const double radius = top ? growth * radius_px : radius_px;
        to_image(radius * wx + (top ? lean_px[0] : 0), radius * wy + (top ? lean_px[1] : 0), x, y);
    }
};
static_assert(sizeof(Silhouette) == 8 * sizeof(double));

}  // namespace plate
