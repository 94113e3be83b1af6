// Bindings of the chapter `discs`.
#include <nanobind/stl/array.h>

#include "discs/fit.hpp"
#include "discs/marks.hpp"
#include "discs/measure.hpp"
#include "discs/seeds.hpp"
#include "discs/silhouette.hpp"
#include "plate/binding.hpp"

namespace plate {

namespace {

using nb::arg;

constexpr double MOST_RADIUS_PX = 1e4;

bool is_radius(double radius) { return radius > 0 && radius <= MOST_RADIUS_PX; }

void require_radii(const In<double, 1>& radii, size_t count) {
    require(radii.shape(0) == count, "shape: radii (n,)");
    for (size_t k = 0; k < count; k++)
        require(is_radius(radii(k)), "radii: allowed: more than 0, up to 1e4 px");
}

// Rows of numbers that are silhouettes.
const Silhouette* as_silhouettes(const In<double, 2>& rows, size_t count) {
    require(rows.shape(0) == count && rows.shape(1) == sizeof(Silhouette) / sizeof(double),
            "shape: silhouettes (n, 8)");
    const auto* parts = reinterpret_cast<const Silhouette*>(rows.data());
    for (size_t k = 0; k < count; k++) {
        require(is_radius(parts[k].radius_px), "radius: allowed: more than 0, up to 1e4 px");
        require(parts[k].is_finite() && parts[k].reach() <= 2 * MOST_RADIUS_PX,
                "silhouettes: allowed: an area, and a reach of up to 2e4 px");
    }
    return parts;
}

bool are_pairs(const In<double, 2>& places) { return places.shape(1) == 2; }

// Rows of numbers that are discs.
Disc* as_discs(const Array<double, 2>& rows, size_t count) {
    require(rows.shape(0) == count && rows.shape(1) == sizeof(Disc) / sizeof(double),
            "shape: discs (n, 7)");
    return reinterpret_cast<Disc*>(rows.data());
}

Grid as_grid(const std::array<int, 3>& grid) {
    require(grid[0] >= 0 && grid[1] >= 0 && grid[2] > 0, "grid: allowed: x, y >= 0, step >= 1");
    return {grid[0], grid[1], grid[2]};
}

}  // namespace

void bind_discs(nb::module_& m) {
    m.attr("RIM_PX") = RIM_PX;

    m.def("measure_alone", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable,
                              In<int64_t, 2> seeds, In<double, 2> parts, In<bool, 1> alone,
                              Array<double, 2> discs, Array<double, 1> dirt) {
        const LitPlate plate = lit_plate(grey, light, usable);
        const size_t count = seeds.shape(0);
        require(seeds.shape(1) == 2 && alone.shape(0) == count && dirt.shape(0) == count,
                "shapes: seeds (n, 2), alone and dirt (n,)");
        Disc* out = as_discs(discs, count);
        const Silhouette* shapes = as_silhouettes(parts, count);
        nb::gil_scoped_release others_may_run;
        measure_alone(plate, view(seeds), shapes, alone.data(), out, dirt.data());
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert(), arg().noconvert());
    m.def("crowded", [](In<double, 2> centre, double distance_px, Array<bool, 1> near) {
        require(are_pairs(centre) && near.shape(0) == centre.shape(0),
                "shapes: centre (n, 2), near (n,)");
        nb::gil_scoped_release others_may_run;
        crowded(view(centre), distance_px, near.data());
    }, arg(), arg(), arg().noconvert());
    m.def("fit_discs", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable,
                          In<double, 2> seeds, In<double, 2> parts, In<double, 2> cast,
                          double shade, double edge_px, double noise, Array<double, 2> discs) {
        const LitPlate plate = lit_plate(grey, light, usable);
        require(are_pairs(seeds), "shape: seeds (n, 2)");
        Disc* out = as_discs(discs, seeds.shape(0));
        const Silhouette* shapes = as_silhouettes(parts, seeds.shape(0));
        require(shade == 0 || (are_pairs(cast) && cast.shape(0) == seeds.shape(0)),
                "shape: cast (n, 2)");
        require(shade >= 0 && shade <= 1 && edge_px > 0, "shade: allowed: 0 to 1, edge_px: above 0");
        for (size_t k = 0; shade > 0 && k < cast.shape(0); k++)
            require(std::hypot(cast(k, 0), cast(k, 1)) <= MOST_RADIUS_PX,
                    "cast: allowed: up to 1e4 px");
        nb::gil_scoped_release others_may_run;
        fit_discs(plate, view(seeds), shapes, {cast.data(), shade, edge_px}, noise, out);
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert());
    m.def("find_marks", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable,
                           In<double, 2> seeds, In<double, 1> radii, double noise) {
        const LitPlate plate = lit_plate(grey, light, usable);
        require(are_pairs(seeds), "shape: seeds (n, 2)");
        require_radii(radii, seeds.shape(0));
        const size_t count = seeds.shape(0);
        const std::array<int, 2> shape{static_cast<int>(count), 2};
        std::vector<double> found(2 * count), level(2 * count);
        {
            nb::gil_scoped_release others_may_run;
            find_marks(plate, view(seeds), radii.data(), noise, {found.data(), shape}, {level.data(), shape});
        }
        return nb::make_tuple(to_numpy<2>(std::move(found), {count, 2}),
                              to_numpy<2>(std::move(level), {count, 2}));
    });
    m.def("paint_marks", [](Array<uint8_t, 2> grey, In<double, 2> centre, In<double, 2> level,
                            In<double, 1> radii) {
        require(are_pairs(centre) && are_pairs(level) && level.shape(0) == centre.shape(0),
                "shapes: centre and level (n, 2)");
        require_radii(radii, centre.shape(0));
        nb::gil_scoped_release others_may_run;
        paint_marks(view(grey), view(centre), view(level), radii.data());
    }, arg().noconvert(), arg(), arg(), arg());
    m.def("find_dark", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable,
                          double threshold, std::array<int, 3> corner, In<bool, 2> outside,
                          Array<uint8_t, 2> dark) {
        const LitPlate plate = lit_plate(grey, light, usable);
        const Grid grid = as_grid(corner);
        const int64_t rows = dark.shape(0), columns = dark.shape(1);
        require(same_pixels(dark, outside), "shapes: dark and outside (h, w)");
        require(grid.y + (rows - 1) * grid.step < plate.height() &&
                    grid.x + (columns - 1) * grid.step < plate.width(),
                "the grid leaves the image");
        nb::gil_scoped_release others_may_run;
        find_dark(plate, threshold, grid, view(outside), view(dark));
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert());
    m.def("find_blobs", [](Array<bool, 2> core, Array<int32_t, 2> number) {
        require(same_pixels(core, number), "shapes: core and number (h, w)");
        std::vector<Blob> found;
        {
            nb::gil_scoped_release others_may_run;
            found = find_blobs(view(core), view(number));
        }
        constexpr size_t NUMBERS = sizeof(Blob) / sizeof(double);
        std::vector<double> rows(NUMBERS * found.size());
        std::copy_n(reinterpret_cast<const double*>(found.data()), rows.size(), rows.data());
        return to_numpy<2>(std::move(rows), {found.size(), NUMBERS});
    }, arg().noconvert(), arg().noconvert());
    m.def("vote", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable, int x0, int y0,
                     In<double, 2> part, Array<float, 2> votes) {
        const LitPlate plate = lit_plate(grey, light, usable);
        const Silhouette* shape = as_silhouettes(part, 1);
        nb::gil_scoped_release others_may_run;
        vote(plate, x0, y0, *shape, view(votes));
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert());
    m.def("find_peaks", [](In<float, 2> votes, int x0, int y0, In<bool, 2> merged,
                           std::array<int, 3> grid, double radius) {
        require(radius > 0, "radius is not above 0");
        std::vector<double> found;
        {
            nb::gil_scoped_release others_may_run;
            found = find_peaks(view(votes), x0, y0, view(merged), as_grid(grid), radius);
        }
        const size_t count = found.size() / 2;
        return to_numpy<2>(std::move(found), {count, 2});
    });
    m.def("nearest", [](In<double, 2> centres, double x, double y) {
        require(are_pairs(centres), "shape: centres (n, 2)");
        return nearest(centres.data(), centres.shape(0), x, y);
    });
}

}  // namespace plate
