// Python bindings of the kernels that simulate all parts.
#include <plate/bind.hpp>

#include <atomic>
#include <thread>
#include <vector>

#include "records.hpp"
#include "world/bodies.hpp"

namespace plate {

namespace {

// Returns whether the indices `first` to `end` - 1 are all from 0 to `count` - 1. The range may be
// empty.
bool within(std::int64_t first, std::int64_t end, size_t count) {
    return 0 <= first && first <= end && end <= static_cast<std::int64_t>(count);
}

// Returns the subarray with the index k of the first axis.
template <class T, int N>
View<T, N - 1> entry(const View<T, N>& all, int k) {
    View<T, N - 1> one{all[k], {}};
    std::copy_n(all.shape.begin() + 1, N - 1, one.shape.begin());
    return one;
}

// Simulates the parts on N plates with several threads. bodies.py describes the arguments. All
// arguments are checked before the first simulation starts. Returns four values for each plate: the
// indices of the two parts with the deepest overlap at the start, the depth of this overlap [m],
// and the depth divided by half the width of the slimmer part.
nb::ndarray<nb::numpy, double, nb::ndim<2>> run_plates(
    Array<const double, 1> times, Array<const double, 3> coefficients,
    Array<const int64_t, 2> counts, int cycles, int every, Array<const double, 2> ground,
    Array<double, 3> states, Array<const double, 2> limit, Array<bool, 2> here,
    Array<double, 4> record, Array<const double, 2> bodies, Array<const double, 2> mesh,
    Array<const int64_t, 2> pieces, Array<const double, 2> corners, double restitution,
    double friction, bool meets, bool walls, double allowed, Array<const double, 1> half,
    int threads) {
    const size_t plates = states.shape(0), count = states.shape(1);
    require(states.shape(2) == 6 && bodies.shape(0) == count && limit.shape(0) == plates &&
                limit.shape(1) == count && here.shape(0) == plates && here.shape(1) == count,
            "run: parts differ, allowed: states (N, M, 6), limit and here (N, M), bodies (M, 10)");
    require(counts.shape(0) == plates && counts.shape(1) == 2 && ground.shape(0) == plates &&
                ground.shape(1) == 5 && cycles > 0 && every > 0,
            "run: plates differ, allowed: counts (N, 2), ground (N, 5), cycles and every above 0");
    require(record.shape(0) == plates && record.shape(2) == count && record.shape(3) == 6,
            "run: record has a wrong shape, allowed: (N, k, M, 6)");
    require(mesh.shape(0) == 4 && pieces.shape(1) == 2 && half.size() == 2,
            "run: shapes differ, allowed: mesh (4, n), pieces (p, 2), half (2,)");
    const Shapes shapes{records<Body>("bodies", bodies), view(mesh),
                        {reinterpret_cast<const contacts::Convex*>(pieces.data()), pieces.shape(0)},
                        records<contacts::Corner>("corners", corners)};
    std::int64_t last = 0;
    for (const auto& [first, end] : shapes.pieces) {
        require(last <= first && first < end && within(first, end, shapes.corners.size()),
                "run: a piece has no corners of its own");
        last = end;
    }
    for (const Body& body : shapes.bodies)
        require(within(body.first_point, body.end_point, mesh.shape(1)) &&
                    within(body.first_piece, body.end_piece, shapes.pieces.size()) &&
                    (!meets || body.radius > 0 || body.first_piece < body.end_piece),
                "run: a body has no points or no pieces");
    const View<double, 3> all_states = view(states);
    const View<double, 4> all_records = view(record);
    const View<const double, 2> limits = view(limit), grounds = view(ground);
    const View<bool, 2> all_here = view(here);
    std::vector<Job> jobs;
    std::int64_t knots = 0, rows = 0;
    for (size_t k = 0; k < plates; k++) {
        const std::int64_t own = counts(k, 0), steps = counts(k, 1);
        require(own > 0 && steps > 0 && steps <= INT_MAX / 2 && rows + own <= INT_MAX,
                "run: a motion has no pieces, or not from 1 to 2^30 steps");
        require(record.shape(1) == 0 ||
                    record.shape(1) == static_cast<size_t>(cycles * steps / every + 1),
                "run: record has a wrong shape, allowed: (N, cycles * steps / every + 1, M, 6)");
        jobs.push_back({times.data() + knots, coefficients.data() + 18 * rows,
                        static_cast<int>(own), static_cast<int>(steps), cycles, every,
                        {grounds(k, 0), grounds(k, 1), grounds(k, 2), grounds(k, 3), grounds(k, 4)},
                        entry(all_states, k), limits[k], entry(all_here, k),
                        entry(all_records, k)});
        knots += own + 1, rows += own;
    }
    require(times.shape(0) == static_cast<size_t>(knots) && coefficients.shape(1) == 6 &&
                coefficients.shape(0) == static_cast<size_t>(rows) && coefficients.shape(2) == 3,
            "run: motions differ, allowed: times (K + N,), coefficients (K, 6, 3), K as counted");
    std::vector<double> found(4 * plates);
    {
        nb::gil_scoped_release others_may_run;
        const contacts::Rules rules{restitution, friction, meets, walls};
        std::atomic<size_t> next{0};
        const auto work = [&] {
            for (size_t k; (k = next++) < plates;) {
                const auto [i, j, depth, relative_depth] =
                    run(jobs[k], shapes, rules, allowed, half.data());
                const double row[] = {1.0 * i, 1.0 * j, depth, relative_depth};
                std::copy_n(row, 4, &found[4 * k]);
            }
        };
        std::vector<std::jthread> helpers;
        for (int k = 1; k < threads; k++) helpers.emplace_back(work);
        work();
    }
    return to_numpy<2>(std::move(found), {plates, 4});
}

}  // namespace

void bind_world(nb::module_& m) {
    using nb::arg;
    m.def("run", run_plates, arg("times"), arg("coefficients"), arg("counts"), arg("cycles"),
          arg("every"), arg("ground"), arg("states").noconvert(), arg("limit"),
          arg("here").noconvert(), arg("record").noconvert(), arg("bodies"), arg("mesh"),
          arg("pieces"), arg("corners"), arg("restitution"), arg("friction"), arg("meets"),
          arg("walls"), arg("allowed"), arg("half"), arg("threads"));
}

}  // namespace plate
