// Error of a mean over equal time steps, caused by times at which the slip of a part nearly
// vanishes.
//
// Symbols:
// - t: time, scaled so that one period is 2 pi
// - w = (wx, wy): slip velocity of the part
// - n: number of equal time steps per period
// - a + i b and a - i b: complex times at which wx^2 + wy^2 = 0 (branch points)
// - dip: a time a at which the slip nearly vanishes, because b is small
// - u: integration variable
//
// The slip's direction w/|w| is an analytic function of t, except at the branch points. The mean of
// w/|w| over n equal steps differs from the true mean. This error is exactly a sum of integrals
// along branch cuts. Each cut begins at a branch point and continues parallel to the positive
// imaginary axis. The points of a cut are t = a + i b cosh u with u from 0 to infinity. The
// integral of one dip is
//
//     -2/pi Re integral of w / sqrt(Q) q / (1 + q) du from 0 to infinity, with q = exp(i n t) and
//     Q = (wx^2 + wy^2) / (-(b sinh u)^2)
//
// The integrand is an even function of u and decreases like exp(-n b cosh u). The poles of the
// integrand are at Im u = pi/2 for any b. Therefore the same equal steps of u are sufficient for
// any b. The time steps do not have to be shortened near a dip.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate::near_zero_slip {

constexpr double PI = std::numbers::pi;

// Step of the integration variable u. With this step, the relative error of the integral is
// exp(-pi^2 / STEP) = 2e-8.
constexpr double STEP = 0.55;

// The integral over u is computed as a sum over nodes. WEIGHT is the weight of each node. Only
// nodes with u > 0 are summed, because the integrand is an even function of u.
constexpr double WEIGHT = 2 / PI * STEP;

// Maximum number of nodes of the sum over u. This number is sufficient for b = NARROWEST.
constexpr int MAX_NODES = 44;

// Minimum distance b of a branch point from the real axis [rad]. Smaller distances are replaced by
// this value, because the slip's direction practically jumps there.
constexpr double NARROWEST = 1e-10;

// Maximum value of n b cosh u at a node of the sum over u. Here, n is the number of steps per
// period. Nodes with a larger value are neglected, because the integrand is below 4e-8 there.
constexpr double FADED = 17.0;

// Maximum product n b for which the mean over equal steps needs a correction. Here, n is the number
// of steps per period, and b [rad] is the distance of the branch point from the real axis. The
// error of the mean is exp(-n b). For larger products, this error is negligible.
constexpr double NEAR = 14.0;

// Value of b^2/2 for n b = NEAR, if the unit of b is one time step. `dip_of` estimates b^2/2 from
// the parabola through three samples of the squared slip. The estimate is the minimum of the
// parabola divided by its second difference.
constexpr double STEPS_NEAR = (NEAR / (2 * PI)) * (NEAR / (2 * PI)) / 2;

// Minimum distance [time steps] between two dips that are corrected separately. If two dips are
// closer, one of them may not appear as a minimum of the samples.
constexpr double CLOSE = 4.0;

// Maximum number of Newton steps that locate a complex zero of the slip. Usually three steps are
// enough, because the search starts at a minimum of the samples.
constexpr int NEWTON_STEPS = 10;

struct Nodes {
    std::array<double, MAX_NODES> cosh, sinh;
};

inline const Nodes NODES_OF_U = [] {
    Nodes nodes;
    for (int k = 0; k < MAX_NODES; k++)
        nodes.cosh[k] = std::cosh((k + 0.5) * STEP), nodes.sinh[k] = std::sinh((k + 0.5) * STEP);
    return nodes;
}();

// A complex number. Unlike std::complex, the multiplication does not check for infinite values.
struct Complex {
    double real = 0, imag = 0;
};

inline Complex operator+(Complex a, Complex b) { return {a.real + b.real, a.imag + b.imag}; }
inline Complex operator-(Complex a, Complex b) { return {a.real - b.real, a.imag - b.imag}; }
inline Complex operator*(Complex a, Complex b) {
    return {a.real * b.real - a.imag * b.imag, a.real * b.imag + a.imag * b.real};
}
inline Complex operator*(double a, Complex b) { return {a * b.real, a * b.imag}; }
inline Complex conjugate(Complex a) { return {a.real, -a.imag}; }
inline double square(Complex a) { return a.real * a.real + a.imag * a.imag; }

// Returns a positive number if three consecutive samples of the squared slip show a dip. Two
// conditions define a dip: the middle sample is a minimum, and n b of the parabola through the
// samples is below NEAR.
[[gnu::always_inline]] inline double dip_of(double before, double here, double after) {
    const double bend = before - 2 * here + after, slope = after - before;
    const double depth = STEPS_NEAR * bend * bend - (here * bend - slope * slope / 8);
    return (here <= before) & (here < after) ? depth : -1.0;
}

// Detects dips in the samples of the squared slip (n,). Writes the indices of the dips to `found`
// (n,) and returns the number of dips.
[[gnu::always_inline]] inline int find_dips(const double* __restrict square, int n,
                                            double* __restrict found) {
    found[0] = dip_of(square[n - 1], square[0], square[1]);
#pragma omp simd
    for (int k = 1; k < n - 1; k++) found[k] = dip_of(square[k - 1], square[k], square[k + 1]);
    found[n - 1] = dip_of(square[n - 2], square[n - 1], square[0]);
    int count = 0;
    const auto collect = [&](int first, int last) {
        for (int k = first; k < last; k++) {  // a loop without branches
            const bool hit = found[k] > 0;
            found[count] = k;
            count += hit;
        }
    };
    int k = 0;
    for (; k + 8 <= n; k += 8) {
        double maximum = found[k];
        for (int i = 1; i < 8; i++) maximum = std::max(maximum, found[k + i]);
        if (maximum > 0) collect(k, k + 8);
    }
    collect(k, n);
    return count;
}

struct BranchPoint {
    Complex middle;  // exp(i a)
    double b;
    bool isolated;
};

// Computes a complex zero a + i b of wx + i wy by Newton's method. The first estimate is the time t
// with exp(i t) = `start`. The result contains exp(i a) and |b|. `isolated` is true if the method
// has converged and no other zero is within `close` [rad]. The rows of `slip` (2 N + 1, 2) [m/s]
// are the coefficients of sin 1..N and cos 1..N, and the constant term.
inline BranchPoint branch_point(View<const double, 2> slip, Complex start, double close) {
    const int number = slip.size(0) / 2;
    Complex z = start;  // the slip times z^N is a polynomial of z = exp(i t)
    Complex slope, bend;
    double last = 1, radial_offset = 1;
    for (int step = 0; step < NEWTON_STEPS; step++) {
        Complex value;
        slope = bend = {};
        for (int k = number; k >= -number; k--) {
            Complex term;
            if (k > 0) {
                const double *s = slip[k - 1], *c = slip[number + k - 1];
                term = {(c[0] + s[1]) / 2, (c[1] - s[0]) / 2};
            } else if (k < 0) {
                const double *s = slip[-k - 1], *c = slip[number - k - 1];
                term = {(c[0] - s[1]) / 2, (c[1] + s[0]) / 2};
            } else {
                term = {slip(2 * number, 0), slip(2 * number, 1)};
            }
            bend = bend * z + slope;
            slope = slope * z + value;
            value = value * z + term;
        }
        const Complex change = 1 / (square(slope) + 1e-300) * (value * conjugate(slope));
        z = z - change;
        last = square(change), radial_offset = (square(z) - 1) / 2;
        if (last < 1e-10 * radial_offset * radial_offset || last < 1e-24) break;
    }
    const double radius = std::sqrt(square(z)) + 1e-300;
    const bool done = last < 1e-8 * radial_offset * radial_offset || last < 1e-22;
    // At a zero z of the polynomial, bend / slope is the sum of 1 / (z - z_k) over all other zeros
    // z_k. The sum is large if another zero is close.
    const bool isolated = square(bend) * close * close < square(slope);
    return {1 / radius * z, std::max(std::abs(std::log(radius)), NARROWEST), done && isolated};
}

// Harmonic j of the slip. The time t is measured from a, the real part of a branch point. `even`
// and `odd` are the coefficients (x, y) of cos j t and sin j t. `cosine` and `sine` are cos j a and
// sin j a. `by_even` and `by_odd` are the derivatives (xx, xy, yy) of the integral with respect to
// `even` and `odd`.
struct ShiftedHarmonic {
    double even[2], odd[2], cosine, sine, by_even[3], by_odd[3];
};

inline std::vector<ShiftedHarmonic> shifted_harmonics(View<const double, 2> slip, Complex middle) {
    const int number = slip.size(0) / 2;
    std::vector<ShiftedHarmonic> harmonics(number + 1);
    harmonics[0].even[0] = slip(2 * number, 0), harmonics[0].even[1] = slip(2 * number, 1);
    harmonics[0].cosine = 1;
    Complex wave{1, 0};
    for (int j = 1; j <= number; j++) {
        wave = wave * middle;
        const double c = wave.real, s = wave.imag;
        const double *by_sine = slip[j - 1], *by_cosine = slip[number + j - 1];
        for (int axis = 0; axis < 2; axis++) {
            harmonics[j].even[axis] = by_sine[axis] * s + by_cosine[axis] * c;
            harmonics[j].odd[axis] = by_sine[axis] * c - by_cosine[axis] * s;
        }
        harmonics[j].cosine = c, harmonics[j].sine = s;
    }
    return harmonics;
}

struct ComplexSlip {
    Complex x, y;
    double fade;  // exp(-n depth)
};

// Returns the slip at the complex time a + i depth, and exp(-n depth).
inline ComplexSlip complex_slip(const std::vector<ShiftedHarmonic>& harmonics, double depth,
                                int n) {
    const double step = std::exp(-depth);
    double power = 1;
    Complex x{harmonics[0].even[0], 0}, y{harmonics[0].even[1], 0};
    const int number = static_cast<int>(harmonics.size()) - 1;
    for (int j = 1; j <= number; j++) {
        power *= step;
        const double ch = (1 / power + power) / 2, sh = (1 / power - power) / 2;
        x.real += harmonics[j].even[0] * ch;
        y.real += harmonics[j].even[1] * ch;
        x.imag += harmonics[j].odd[0] * sh;
        y.imag += harmonics[j].odd[1] * sh;
    }
    for (int m = number; m < n; m *= 2) power *= power;
    return {x, y, power};
}

// Returns -q / (1 + q), which is the sum of (-q)^m over all m from 1. This sum contains all
// aliasing errors of a mean over n equal steps.
inline Complex aliases(Complex q) {
    const double scale = -1 / square(Complex{1 + q.real, q.imag});
    return {(q.real + square(q)) * scale, q.imag * scale};
}

// Returns the complex value of 1 / sqrt(value) whose real part is positive.
inline Complex inverse_root(Complex value) {
    const double size = std::sqrt(square(value));
    const double real = std::sqrt((size + value.real) / 2), weight = 1 / size;
    return {real * weight, -0.5 * value.imag / real * weight};
}

// Adds the contribution of one node of the sum over u to the derivatives of each harmonic j. (x, y)
// is the slip at the node, and p is `weight` times (y y, -x y, x x). The contribution is Re(p)
// cosh(j depth) to `by_even`, and -Im(p) sinh(j depth) to `by_odd`.
inline void add_slopes(Complex weight, Complex x, Complex y, double depth,
                       std::vector<ShiftedHarmonic>& harmonics) {
    const Complex by[3] = {weight * y * y, -1 * weight * x * y, weight * x * x};
    for (int j = 1; j < static_cast<int>(harmonics.size()); j++) {
        const double ch = std::cosh(j * depth), sh = std::sinh(j * depth);
        for (int row = 0; row < 3; row++) {
            harmonics[j].by_even[row] += by[row].real * ch;
            harmonics[j].by_odd[row] -= by[row].imag * sh;
        }
    }
}

// Corrects the derivatives for the double pole of their integrand at u = 0. The nodes of the sum
// over u begin half a step beside this pole. Therefore the sum differs from the integral by pi^2 /
// STEP times the coefficient of the pole.
inline void add_pole(Complex phase, double b, int n, std::vector<ShiftedHarmonic>& harmonics) {
    const ComplexSlip at = complex_slip(harmonics, b, n);
    Complex dx, dy;  // derivative of the slip with respect to depth
    for (int j = 1; j < static_cast<int>(harmonics.size()); j++) {
        const double ch = j * std::cosh(j * b), sh = j * std::sinh(j * b);
        dx = dx + Complex{harmonics[j].even[0] * sh, harmonics[j].odd[0] * ch};
        dy = dy + Complex{harmonics[j].even[1] * sh, harmonics[j].odd[1] * ch};
    }
    const Complex root = inverse_root(-1 / b * (at.x * dx + at.y * dy));
    const double scale = 0.5 * (PI / STEP / b) * (PI / STEP / b);
    const Complex weight = scale * aliases(at.fade * phase) * root * root * root;
    add_slopes(weight, at.x, at.y, b, harmonics);
}

// The derivatives in `harmonics` belong to harmonics whose time is measured from a. The function
// converts these derivatives to derivatives with respect to the slip's coefficients of sines and
// cosines. The result is subtracted from `gradient` (3, 2 N).
inline void subtract_slopes(const std::vector<ShiftedHarmonic>& harmonics,
                            View<double, 2> gradient) {
    const int number = static_cast<int>(harmonics.size()) - 1;
    for (int j = 1; j <= number; j++) {
        const double c = WEIGHT * harmonics[j].cosine, s = WEIGHT * harmonics[j].sine;
        for (int row = 0; row < 3; row++) {
            const double even = harmonics[j].by_even[row], odd = harmonics[j].by_odd[row];
            gradient(row, j - 1) -= s * even + c * odd;
            gradient(row, number + j - 1) -= c * even - s * odd;
        }
    }
}

struct Excess {
    double x, y;
    // if false, the caller must use `by_panels`, for example because another dip is close
    bool valid;
};

// Computes the error [mu m g] of the average force over n equal steps that one dip causes. The dip
// is near the time t with exp(i t) = `start`. The integral at the top of this file is the error.
// The number n must be N times a power of 2. If `gradient` is not empty, the error of the
// derivatives is subtracted from `gradient`.
inline Excess excess(View<const double, 2> slip, Complex start, int n, View<double, 2> gradient) {
    const BranchPoint point = branch_point(slip, start, CLOSE * 2 * PI / n);
    const double b = point.b, farthest = 1.5 * 2 * PI / n;
    if (!point.isolated || square(point.middle - start) > farthest * farthest || n * b > 2 * NEAR)
        return {0, 0, false};
    std::vector<ShiftedHarmonic> harmonics = shifted_harmonics(slip, point.middle);
    const int number = static_cast<int>(harmonics.size()) - 1;
    Complex phase{harmonics[number].cosine, harmonics[number].sine};
    for (int m = number; m < n; m *= 2) phase = phase * phase;  // exp(i n a)
    const bool sloped = gradient.size(0) > 0;
    if (sloped) add_pole(phase, b, n, harmonics);
    double fx = 0, fy = 0;
    for (int u = 0; u < MAX_NODES; u++) {
        const double depth = b * NODES_OF_U.cosh[u];
        if (n * depth > FADED) break;
        const ComplexSlip at = complex_slip(harmonics, depth, n);
        const double slope = b * NODES_OF_U.sinh[u], across = -1 / (slope * slope);
        const Complex value = across * (at.x * at.x + at.y * at.y);
        if (!(value.real > 0)) return {0, 0, false};
        const Complex root = inverse_root(value), weight = aliases(at.fade * phase) * root;
        fx += (weight * at.x).real;
        fy += (weight * at.y).real;
        if (sloped) add_slopes(across * (weight * root * root), at.x, at.y, depth, harmonics);
    }
    if (sloped) subtract_slopes(harmonics, gradient);
    return {WEIGHT * fx, WEIGHT * fy, true};
}

}  // namespace plate::near_zero_slip
