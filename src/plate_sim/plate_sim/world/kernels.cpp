// What Python sees of the kernels that move all parts.
#include <plate/bind.hpp>

#include <atomic>
#include <thread>
#include <typeinfo>
#include <utility>
#include <vector>

#include "records.hpp"
#include "world/bodies.hpp"

namespace plate {

namespace {

// Whether [first, end) is a range within `count`.
bool within(std::int64_t first, std::int64_t end, size_t count) {
    return 0 <= first && first <= end && end <= static_cast<std::int64_t>(count);
}

// One call of `run`, checked.
struct Job {
    Table motion;
    int steps, cycles, every;
    GroundEffect ground;
    View<double, 2> state;
    Shapes shapes;
    contacts::Rules rules;
    double allowed;
    const double* half;
    View<bool, 1> here;
    View<double, 3> record;
    contacts::Overlap start;

    void operator()() {
        start = run(motion, steps, cycles, every, ground, state, shapes, rules, allowed, half, here,
                    record);
    }
    nb::tuple found() const {
        return nb::make_tuple(start.first, start.second, start.depth, start.share);
    }
};

Job checked(Array<const double, 2> table, int steps, int cycles, int every, double gravity_x,
            double gravity_y, double static_ratio, double slope, Array<double, 2> state,
            Array<const double, 2> bodies, Array<const double, 2> discs, Array<double, 2> mesh,
            Array<const int64_t, 2> pieces, Array<const double, 2> corners, double restitution,
            double friction, bool meets, bool walls, double allowed, Array<const double, 1> half,
            Array<bool, 1> here, Array<double, 3> record) {
    const Table motion = records<Piece>("table", table);
    require(!motion.empty() && steps > 0 && cycles > 0 && every > 0,
            "run: table is empty, or a count is not positive");
    const size_t count = here.size(), columns = state.shape(1);
    require(state.shape(0) == 6 && columns > count && bodies.shape(0) == columns &&
                discs.shape(0) == 4 && discs.shape(1) + 1 == columns,
            "run: state, bodies, discs and here differ, allowed: (6, P), P, (4, P - 1), below P");
    require(mesh.shape(0) == 7 && pieces.shape(1) == 2 && half.size() == 2,
            "run: shapes differ, allowed: mesh (7, n), pieces (p, 2), half (2,)");
    const size_t frames = static_cast<std::int64_t>(cycles) * steps / every + 1;
    require(record.shape(0) == 0 || (record.shape(0) == frames && record.shape(1) == count &&
                                     record.shape(2) == 6),
            "run: record has another shape, allowed: (cycles * steps / every + 1, M, 6)");
    const Shapes shapes{records<Body>("bodies", bodies), view(discs), view(mesh),
                        {reinterpret_cast<const contacts::Convex*>(pieces.data()), pieces.shape(0)},
                        records<contacts::Corner>("corners", corners)};
    std::int64_t last = 0;
    for (const auto& [first, end] : shapes.pieces) {
        require(last <= first && first < end && within(first, end, shapes.corners.size()),
                "run: a piece has no corners of its own");
        last = end;
    }
    for (const Body& body : shapes.bodies.first(count))
        require(within(body.first_point, body.end_point, mesh.shape(1)) &&
                    within(body.first_piece, body.end_piece, shapes.pieces.size()) &&
                    (!meets || body.radius > 0 || body.first_piece < body.end_piece),
                "run: a body has no points or no pieces");
    return {motion, steps, cycles, every, {gravity_x, gravity_y, static_ratio, slope}, view(state),
            shapes, {restitution, friction, meets, walls}, allowed, half.data(), view(here), view(record), {}};
}

// What Python calls for one of them.
template <class... Arguments>
auto run_with(Job (*make)(Arguments...)) {
    return [make](Arguments... arguments) {
        Job job = make(arguments...);
        {
            nb::gil_scoped_release others_may_run;
            job();
        }
        return job.found();
    };
}

// The checked call whose arguments a tuple holds: none is converted, as they are written to.
template <class... Arguments, size_t... At>
Job unpacked(const nb::tuple& call, Job (*make)(Arguments...), std::index_sequence<At...>) {
    require(call.size() == sizeof...(At), "run_many: a call has another number of arguments");
    try {
        return make(nb::cast<Arguments>(call[At], false)...);
    } catch (const std::bad_cast&) {
        throw nb::type_error("run_many: an argument has another type or shape");
    }
}

// The calls of `run` in a list, on several cores: all are checked before the first begins.
nb::list run_many(const nb::list& calls, int threads) {
    std::vector<Job> jobs;
    for (nb::handle call : calls)
        jobs.push_back(unpacked(nb::cast<nb::tuple>(call), checked, std::make_index_sequence<22>()));
    {
        nb::gil_scoped_release others_may_run;
        std::atomic<size_t> next{0};
        const auto work = [&] {
            for (size_t at; (at = next++) < jobs.size();) jobs[at]();
        };
        std::vector<std::jthread> helpers;
        for (int k = 1; k < threads; k++) helpers.emplace_back(work);
        work();
    }
    nb::list found;
    for (const Job& job : jobs) found.append(job.found());
    return found;
}


}  // namespace

void bind_world(nb::module_& m) {
    using nb::arg;
    m.def("run_many", run_many, arg("calls"), arg("threads"));
    m.def("run", run_with(checked), arg("table"), arg("steps"), arg("cycles"), arg("every"),
          arg("gravity_x"), arg("gravity_y"), arg("static_ratio"), arg("slope"),
          arg("state").noconvert(), arg("bodies"), arg("discs"), arg("mesh").noconvert(), arg("pieces"), arg("corners"),
          arg("restitution"), arg("friction"), arg("meets"), arg("walls"), arg("allowed"),
          arg("half"), arg("here").noconvert(), arg("record").noconvert());
}

}  // namespace plate
