// Python bindings of the kernels in `plate`.
#include <nanobind/stl/array.h>

#include "plate/binding.hpp"
#include "plate/contrast.hpp"
#include "plate/region.hpp"

namespace plate {

void bind_plate(nb::module_& m) {
    m.attr("SEAM_PX") = SEAM_PX;

    m.def("region_depth", [](In<double, 2> edges, In<double, 2> bows, In<double, 1> x,
                             In<double, 1> y) {
        const size_t count = x.shape(0);
        require_edges(edges, bows);
        require(y.shape(0) == count, "shapes: x and y (m,)");
        std::vector<double> depth(count);
        {
            nb::gil_scoped_release others_may_run;
            region_depth(view(edges), view(bows), x.data(), y.data(), count, depth.data());
        }
        return to_numpy<1>(std::move(depth), {count});
    });
    m.def("fit_light", [](In<uint8_t, 2> grey, In<int64_t, 1> rows, In<int64_t, 1> columns,
                          In<float, 2> design, double min_grey) {
        const size_t count = rows.shape(0);
        require(count > 0 && columns.shape(0) == count && design.shape(0) == TERMS &&
                    design.shape(1) == count,
                "shapes: rows and columns (n,), design (6, n), n >= 1");
        for (size_t i = 0; i < count; i++)
            require(0 <= rows(i) && rows(i) < static_cast<int64_t>(grey.shape(0)) &&
                        0 <= columns(i) && columns(i) < static_cast<int64_t>(grey.shape(1)),
                    "rows, columns: allowed: inside the image");
        std::vector<float> surface;
        {
            nb::gil_scoped_release others_may_run;
            surface = fit_light(view(grey), view(rows), view(columns), view(design), min_grey);
        }
        const size_t size = surface.size();
        return to_numpy<1>(std::move(surface), {size});
    });
    m.def("write_contrast", [](In<uint8_t, 3> image, In<float, 2> lights, std::array<int, 4> box,
                               Array<uint8_t, 2> out) {
        require_lights(image, lights);
        const auto [x0, y0, x1, y1] = box;
        require(same_pixels(image, out) && 0 <= x0 && x0 <= x1 && 0 <= y0 && y0 <= y1 &&
                    x1 <= static_cast<int64_t>(image.shape(1)) &&
                    y1 <= static_cast<int64_t>(image.shape(0)),
                "out: allowed: (h, w), box: within the image");
        nb::gil_scoped_release others_may_run;
        write_contrast(view(image), view(lights), x0, y0, x1, y1, view(out));
    }, nb::arg(), nb::arg(), nb::arg(), nb::arg().noconvert());
    m.def("find_deviating", [](In<uint8_t, 3> image, In<float, 2> lights, double limit,
                         std::array<int, 3> grid, Array<uint8_t, 2> out) {
        require_lights(image, lights);
        require_grid(grid, out.shape(0), out.shape(1), image);
        nb::gil_scoped_release others_may_run;
        find_deviating(view(image), view(lights), limit, grid, view(out));
    }, nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg().noconvert());
    m.def("find_brightness", [](In<uint8_t, 3> image, In<float, 2> lights, In<double, 2> places,
                                In<double, 1> radii, double inner) {
        require_lights(image, lights);
        const size_t count = places.shape(0);
        require(places.shape(1) == 2 && radii.shape(0) == count, "shapes: places (n, 2), radii (n,)");
        std::vector<double> found(count);
        {
            nb::gil_scoped_release others_may_run;
            find_brightness(view(image), view(lights), view(places), radii.data(), inner,
                            found.data());
        }
        return to_numpy<1>(std::move(found), {count});
    });
    m.def("bare", [](In<float, 1> light, double x_px, double y_px) {
        require(light.shape(0) == 9, "shape: light (9,)");
        return bare(light.data(), x_px, y_px);
    });
}

}  // namespace plate
