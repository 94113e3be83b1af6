#include "piece.h"

#include <math.h>
#include <string.h>

float force_of(const Limits *limits, int motor, const float acceleration[MOTORS])
{
    const float *load = limits->load[motor];
    float force = load[0] * acceleration[0];
    for (int i = 1; i < MOTORS; i++)
        force += load[i] * acceleration[i];
    return force;
}

void piece_at(const Knot *a, const Knot *b, uint32_t elapsed, Setpoint *out)
{
    float ticks = (float)(b->ticks - a->ticks), h = ticks * TICK_S;
    float s = (float)elapsed / ticks;
    for (int m = 0; m < MOTORS; m++) {
        /* Quintic in s = t/h. c3 to c5 follow from the error of a's Taylor polynomial at b. */
        float c1 = h * a->velocity[m], c2 = 0.5f * h * h * a->acceleration[m];
        float dp = b->position[m] - a->position[m] - c1 - c2;
        float dv = h * b->velocity[m] - c1 - 2 * c2;
        float da = h * h * b->acceleration[m] - 2 * c2;
        float c3 = 10 * dp - 4 * dv + 0.5f * da;
        float c4 = -15 * dp + 7 * dv - da;
        float c5 = 6 * dp - 3 * dv + 0.5f * da;
        out->position[m] = a->position[m] + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5))));
        out->velocity[m] = (c1 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + s * (5 * c5))))) / h;
        out->acceleration[m] = (2 * c2 + s * (6 * c3 + s * (12 * c4 + s * (20 * c5)))) / (h * h);
        /* Avoid negative zero, because the sign of a zero depends on the order of the sum. */
        out->position[m] += 0.0f;
        out->velocity[m] += 0.0f;
        out->acceleration[m] += 0.0f;
    }
}

/* Bezier points of position, speed and acceleration of one motor between two knots. */
typedef struct {
    float position[6], speed[5], accel[4];
} Hull;

/* Computed from differences of positions, to avoid cancellation of nearly equal points. */
static void hull(const Knot *a, const Knot *b, int motor, Hull *out)
{
    float h = (float)(b->ticks - a->ticks) * TICK_S;
    float va = h * a->velocity[motor] / 5, vb = h * b->velocity[motor] / 5;
    float aa = h * h * a->acceleration[motor] / 20, ab = h * h * b->acceleration[motor] / 20;
    float pa = a->position[motor], pb = b->position[motor], step = pb - pa;
    *out = (Hull){
        {pa, pa + va, pa + 2 * va + aa, pb - 2 * vb + ab, pb - vb, pb},
        {a->velocity[motor], 5 * (va + aa) / h, 5 * (step - 2 * (va + vb) + (ab - aa)) / h,
         5 * (vb - ab) / h, b->velocity[motor]},
        {a->acceleration[motor], 20 * (step - 2 * vb + ab - 3 * va - 2 * aa) / (h * h),
         20 * (3 * vb - 2 * ab + 2 * va + aa - step) / (h * h), b->acceleration[motor]},
    };
}

/* Integral of the square of a cubic over [0, 1], from its Bezier points (Farouki 2012, 4.2). */
static float mean_square(const float p[4])
{
    return (p[0] * (20 * p[0] + 20 * p[1] + 8 * p[2] + 2 * p[3]) +
            p[1] * (12 * p[1] + 18 * p[2] + 8 * p[3]) + p[2] * (12 * p[2] + 20 * p[3]) +
            20 * p[3] * p[3]) /
           140;
}

/* Keep a curve for bisection if its hull exceeds the limit. */
static void open_curve(PieceCheck *check, const float *points, int count, float limit, int halvings)
{
    bool inside = true;
    for (int i = 0; i < count; i++)
        inside = inside && fabsf(points[i]) <= limit; /* also false if a point is not finite */
    if (inside)
        return;
    Curve *curve = &check->open[check->opens++];
    memcpy(curve->points, points, (size_t)count * sizeof *points);
    curve->limit = limit;
    curve->count = (uint8_t)count;
    curve->halvings = (uint8_t)halvings;
}

static void begin_check(PieceCheck *check, const Knot *a, const Knot *b, const Limits *limits,
                        float heat[MOTORS])
{
    const float slack = 1 + LIMIT_SLACK, h = (float)(b->ticks - a->ticks) * TICK_S;
    Hull hulls[MOTORS];
    check->opens = check->halved = 0;
    check->begun = true;
    for (int m = 0; m < MOTORS; m++) {
        hull(a, b, m, &hulls[m]);
        open_curve(check, hulls[m].position, 6, limits->stroke_m * slack, HALVINGS);
        open_curve(check, hulls[m].speed, 5, limits->speed * slack, HALVINGS);
        open_curve(check, hulls[m].accel, 4, limits->accel * slack, HALVINGS);
    }
    for (int m = 0; m < MOTORS; m++) {
        float force[4];
        for (int i = 0; i < 4; i++) {
            float accel[MOTORS];
            for (int k = 0; k < MOTORS; k++)
                accel[k] = hulls[k].accel[i];
            force[i] = force_of(limits, m, accel);
        }
        open_curve(check, force, 4, limits->force * slack, HALVINGS);
        heat[m] += mean_square(force) * h;
    }
}

/* Bisect the last kept curve. Return false if it certainly exceeds its limit, or if the bisections do not
   suffice to decide. */
static bool halve(PieceCheck *check)
{
    Curve whole = check->open[--check->opens];
    int n = whole.count;
    if (++check->halved > MAX_HALVINGS || whole.halvings == 0 ||
        !(fabsf(whole.points[0]) <= whole.limit) || !(fabsf(whole.points[n - 1]) <= whole.limit))
        return false;
    float left[6], *rest = whole.points; /* `whole` becomes the right half */
    for (int k = 0; k < n; k++) { /* de Casteljau */
        left[k] = rest[0];
        for (int i = 0; i + 1 < n - k; i++)
            rest[i] = 0.5f * (rest[i] + rest[i + 1]);
    }
    open_curve(check, rest, n, whole.limit, whole.halvings - 1);
    open_curve(check, left, n, whole.limit, whole.halvings - 1);
    return true;
}

bool piece_check(PieceCheck *check, const Knot *a, const Knot *b, const Limits *limits, int *work,
                 float heat[MOTORS], bool *keeps)
{
    if (!check->begun) {
        begin_check(check, a, b, limits, heat);
        *work -= PIECE_WORK;
    }
    *keeps = true;
    while (check->opens > 0 && *keeps) {
        if (*work <= 0)
            return false;
        *work -= 1;
        *keeps = halve(check);
    }
    check->begun = false;
    return true;
}
