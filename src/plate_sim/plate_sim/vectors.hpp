// Vectors in the plane.
#pragma once

namespace plate {

struct Vec {
    double x, y;
};

inline Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y}; }
inline Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y}; }
inline Vec operator*(double scale, Vec a) { return {scale * a.x, scale * a.y}; }
inline double dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y; }

}  // namespace plate
