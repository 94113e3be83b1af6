// Python bindings of blocks.hpp, stick_slip.hpp and turning.hpp.
#include "cycle_map/blocks.hpp"
#include "cycle_map/stick_slip.hpp"
#include "cycle_map/turning.hpp"
#include "records.hpp"

namespace plate {

using namespace nb::literals;

// Returns rows `at` and `at + 1` of the matrix of parts, as (M, 2).
static auto pairs_of(const Matrix& parts, int at, size_t count) {
    std::vector<double> pairs(2 * count);
    for (size_t i = 0; i < count; i++)
        for (int row = 0; row < 2; row++) pairs[2 * i + row] = parts[at + row][i];
    return to_numpy<2>(std::move(pairs), {count, 2});
}

static auto row_of(const Matrix& parts, int at, size_t count) {
    return to_numpy<1>({parts[at], parts[at] + count}, {count});
}

// Checks the shapes of the samples (n, 3) of the plate's motion. `dt` (n,) contains the length of
// each time step [s].
static void check_motion(const Table& pose, const Table& twist, const Numbers& dt) {
    check("twist", twist, {dt.size(), 3});
    check("pose", pose, {dt.size(), 3});
}

// Checks the arrays of parts that are modelled as points. Returns the matrix of these parts.
static Matrix points_of(const Table& position, const Table& velocity, const Numbers& friction_accel,
                        int rows = stick_slip::ROWS) {
    const size_t count = position.shape(0);
    check("position", position, {count, 2});
    check("velocity", velocity, {count, 2});
    if (friction_accel.size() < count)
        throw nb::value_error("friction_accel is not given for all parts");
    Matrix parts;
    put_side_by_side(view(position), view(velocity), view(friction_accel), rows, parts);
    return parts;
}

// Does the same for parts that rotate.
static Matrix bodies_of(const Table& position, const Table& velocity, const Numbers& spin,
                        const Table& spread, const Numbers& friction_accel) {
    Matrix parts = points_of(position, velocity, friction_accel, end_turning_rows::ROWS);
    check("spin", spin, {position.shape(0)});
    check("spread", spread, {position.shape(0), 3});
    put_rotations(view(spin), view(spread), parts);
    return parts;
}

// Returns the derivatives of `each` results with respect to pose, twist and step length dt. The
// shapes of the derivatives are (2, n, each), (3, n, each) and (n, each).
template <class Find>
static nb::tuple gradient_of(size_t n, size_t each, Find find) {
    std::vector<double> by_pose(2 * n * each), by_twist(3 * n * each), by_dt(n * each);
    {
        const int steps = n, wide = each;
        nb::gil_scoped_release others_may_run;
        static thread_local Matrix past;
        find(past, View<double, 3>{by_pose.data(), {2, steps, wide}},
             View<double, 3>{by_twist.data(), {3, steps, wide}},
             View<double, 2>{by_dt.data(), {steps, wide}});
    }
    return nb::make_tuple(to_numpy<3>(std::move(by_pose), {2, n, each}),
                          to_numpy<3>(std::move(by_twist), {3, n, each}),
                          to_numpy<2>(std::move(by_dt), {n, each}));
}

static void bind_stick_slip(nb::module_& m) {
    m.def("end_state", [](Table position, Table velocity, Table pose, Table twist, Numbers dt,
                          Numbers friction_accel) {
        check_motion(pose, twist, dt);
        Matrix parts = points_of(position, velocity, friction_accel);
        {
            nb::gil_scoped_release others_may_run;
            end_state(parts, samples(pose), samples(twist), dt.data());
        }
        const size_t count = position.shape(0);
        return nb::make_tuple(pairs_of(parts, stick_slip::X, count),
                              pairs_of(parts, stick_slip::VX, count));
    });
    m.def("end_state_gradient", [](Table position, Table velocity, Table pose, Table twist,
                                   Numbers dt, Numbers friction_accel, double coast) {
        check_motion(pose, twist, dt);
        Matrix parts = points_of(position, velocity, friction_accel);
        const size_t count = position.shape(0);
        return gradient_of(dt.size(), 2 * count, [&](auto& past, auto... by) {
            end_state_gradient(parts, count, samples(pose), samples(twist), dt.data(), coast, past,
                               by...);
        });
    });
}

static void bind_turning(nb::module_& m) {
    m.def("end_turning", [](Table position, Table velocity, Numbers spin, Table spread, Table pose,
                            Table twist, Numbers dt, Numbers friction_accel) {
        using namespace end_turning_rows;
        check_motion(pose, twist, dt);
        Matrix parts = bodies_of(position, velocity, spin, spread, friction_accel);
        {
            nb::gil_scoped_release others_may_run;
            end_turning(parts, samples(pose), samples(twist), dt.data());
        }
        const size_t count = position.shape(0);
        return nb::make_tuple(pairs_of(parts, X, count), pairs_of(parts, VX, count),
                              row_of(parts, TURN, count), row_of(parts, SPIN, count));
    });
    m.def("end_turning_gradient", [](Table position, Table velocity, Numbers spin, Table spread,
                                     Table pose, Table twist, Numbers dt, Numbers friction_accel,
                                     double coast) {
        check_motion(pose, twist, dt);
        Matrix parts = bodies_of(position, velocity, spin, spread, friction_accel);
        const size_t count = position.shape(0);
        return gradient_of(dt.size(), 3 * count, [&](auto& past, auto... by) {
            end_turning_gradient(parts, count, samples(pose), samples(twist), dt.data(), coast,
                                 past, by...);
        });
    });
}

// Binds `trace` and `adjoint`, or `trace_turning` and `adjoint_turning`. The functions for rotating
// parts have one more axis, a larger state and more data per time step.
template <auto TRACE_PARTS, auto ADJOINT>
static void bind_blocks(nb::module_& m, const char* trace_name, const char* adjoint_name,
                        size_t axes, size_t state_size, size_t trace_size) {
    using Singles = Array<const float, 2>;
    m.def(trace_name, [=](Array<float, 2> state, Singles pose, Singles twist, float dt,
                          Array<float, 3> steps) {
        check("state", state, {state.shape(0), state_size});
        check("pose", pose, {pose.shape(0), 3});
        check("twist", twist, {pose.shape(0), 3});
        check("steps", steps, {pose.shape(0), state.shape(0), trace_size});
        nb::gil_scoped_release others_may_run;
        TRACE_PARTS(view(state), samples(pose), samples(twist), dt, view(steps));
    }, "state"_a.noconvert(), "pose"_a, "twist"_a, "dt"_a, "steps"_a.noconvert());
    m.def(adjoint_name, [=](Array<const float, 3> steps, Singles twist, float dt, float coast,
                            Array<float, 4> by_twist) {
        const size_t blocks = steps.shape(1), bins = by_twist.shape(0);
        check("steps", steps, {twist.shape(0), blocks, trace_size});
        check("twist", twist, {twist.shape(0), 3});
        check("by_twist", by_twist, {bins, blocks, axes, 3 * LANES});
        if (bins == 0 || twist.shape(0) % bins)
            throw nb::value_error("the number of steps is not a multiple of the number of bins");
        nb::gil_scoped_release others_may_run;
        ADJOINT(view(steps), samples(twist), dt, coast, view(by_twist));
    }, "steps"_a, "twist"_a, "dt"_a, "coast"_a, "by_twist"_a.noconvert());
}

void bind_cycle_map(nb::module_& m) {
    m.attr("LANES") = LANES;
    m.attr("TRACE") = TRACE, m.attr("TURNING_TRACE") = TURNING_TRACE;
    bind_stick_slip(m);
    bind_turning(m);
    bind_blocks<trace, adjoint>(m, "trace", "adjoint", 2, STATE, TRACE);
    bind_blocks<trace_turning, adjoint_turning>(m, "trace_turning", "adjoint_turning", 3,
                                                TURNING_STATE, TURNING_TRACE);
}

}  // namespace plate
