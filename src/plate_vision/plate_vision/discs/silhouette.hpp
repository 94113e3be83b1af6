// Silhouette of a part at a certain position in the image. silhouette.py describes the geometry.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>

#include <plate/length.hpp>

namespace plate {

// Silhouette of a round part. `SILHOUETTE` in silhouette.py describes the fields. `across` (2, 2)
// transforms offsets from the part's position in the image [px] to the disc's frame. In this frame,
// the contour of the base is a circle with the radius `radius_px` around 0. The contour of the top
// is a circle with `growth` times this radius around `lean_px`.
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
    // The image of a flat part is an ellipse with the half axes a and b. Returns (a^2 - b^2) / (a^2
    // + b^2) times the cosine and the sine of twice the direction of a.
    std::array<double, 2> flatness() const {
        // The second moments of the ellipse are proportional to the matrix A^-1 A^-T, where A is
        // `across`.
        const double a = across[0][0], b = across[0][1], c = across[1][0], d = across[1][1];
        const double xx = d * d + b * b, yy = a * a + c * c, xy = -(c * d + a * b);
        return {(xx - yy) / (xx + yy), 2 * xy / (xx + yy)};
    }
    bool is_high() const { return growth != 1 || lean_px[0] != 0 || lean_px[1] != 0; }
    double lean_length() const { return length_of(lean_px[0], lean_px[1]); }

    // Returns the maximum length in the image [px] of a vector that has the length 1 px in the
    // disc's frame.
    double stretch() const {
        // The result is the reciprocal of the smallest singular value of `across`.
        const double a = across[0][0], b = across[0][1], c = across[1][0], d = across[1][1];
        const double half = 0.5 * (a * a + b * b + c * c + d * d), area = a * d - b * c;
        const double minimum =
            std::sqrt(half - std::sqrt(std::max(half * half - area * area, 0.0)));
        return 1 / std::max(minimum, 1e-3);
    }

    // Returns an upper bound of the distance between the part's position and any point of its
    // silhouette in the image [px].
    double reach() const {
        return (std::max(growth, 1.0) * radius_px + lean_length()) * stretch();
    }

    // Compute the vector (x, y) [px] from the part's position to the contour point whose outward
    // normal has the direction (nx, ny) in the image.
    void contour(double nx, double ny, double& x, double& y) const {
        // The inverse transpose of `across` transforms the direction of a normal to the disc's
        // frame.
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
