// Python bindings of the camera's kernels.
#include <plate/bind.hpp>

#include "camera/raster.hpp"
#include "records.hpp"

namespace plate {

namespace {

template <class T, nb::ssize_t N>
using In = Array<const T, N>;

// Returns whether the numbers (n,) are in ascending order (equal neighbours are allowed) and all
// from `low` to `high`.
bool ordered(const View<const int64_t, 1>& numbers, int64_t low, int64_t high) {
    for (int i = 0; i < numbers.size(0); i++) {
        if (numbers(i) < low || numbers(i) > high) return false;
        low = numbers(i);
    }
    return true;
}

void expose(In<float, 1> canvas, In<float, 1> bank, float noise, Array<uint8_t, 1> image) {
    require(bank.size() == canvas.size() && image.size() == canvas.size(),
            "expose: canvas, bank and image differ in size");
    nb::gil_scoped_release others_may_run;
    raster::expose(view(canvas), view(bank), noise, view(image));
}

void draw_plate(Array<float, 1> canvas, In<float, 1> light, In<double, 2> places,
                In<int64_t, 1> pixels, In<double, 2> poses, int copies, double travel,
                In<double, 1> half, double scale, double background, double plate) {
    const size_t count = canvas.size();
    require(light.size() == count && places.shape(0) == count && places.shape(1) == 2,
            "draw_plate: canvas, light and places differ in size");
    require(poses.shape(0) > 0 && poses.shape(1) == 3, "draw_plate: poses are not (s, 3)");
    require(half.size() == 2 && copies > 0, "draw_plate: half is not (2,), or there are no copies");
    nb::gil_scoped_release others_may_run;
    for (size_t p = 0; p < pixels.size(); p++) {
        const int64_t pixel = pixels.data()[p];
        require(pixel >= 0 && pixel < static_cast<int64_t>(count),
                "draw_plate: the index of a pixel is outside the image");
    }
    raster::draw_plate(view(canvas), view(light), view(places), view(pixels), view(poses), copies,
                       travel, half.data(), scale, background, plate);
}

void draw_parts(Array<float, 2> canvas, In<float, 2> light, In<double, 3> places,
                In<int64_t, 2> window, In<double, 1> scale, In<int64_t, 1> copies,
                In<double, 3> path, In<double, 1> radius, In<double, 2> turn, In<double, 1> grey,
                In<double, 1> opacity, In<double, 2> edges, In<int64_t, 1> pieces,
                In<int64_t, 1> first, In<int64_t, 1> hole, In<int64_t, 1> end) {
    const int64_t height = canvas.shape(0), width = canvas.shape(1);
    for (int axis = 0; axis < 2; axis++)
        require(light.shape(axis) == canvas.shape(axis) && places.shape(axis) == canvas.shape(axis),
                "draw_parts: canvas, light and places differ in size");
    const size_t count = grey.size();
    require(places.shape(2) == 2 && path.shape(2) == 2 && turn.shape(1) == 2 &&
                window.shape(1) == 4 && edges.shape(1) == 3 && path.shape(0) >= 2,
            "draw_parts: an array does not have the stated shape");
    for (size_t size : {window.shape(0), scale.size(), copies.size(), path.shape(1), radius.size(),
                        turn.shape(0), opacity.size(), first.size(), hole.size(), end.size()})
        require(size == count, "draw_parts: numbers of parts differ");
    const raster::Sprites sprites{view(window), view(scale), view(copies), view(path),
                                  view(radius), view(turn), view(grey), view(opacity)};
    const raster::Outlines outlines{view(edges), view(pieces), view(first), view(hole), view(end)};
    require(ordered(outlines.pieces, 0, edges.shape(0)),
            "draw_parts: a piece is outside the array of edges");
    for (size_t i = 0; i < count; i++) {
        const int64_t* box = sprites.window[i];
        require(box[0] >= 0 && box[1] <= height && box[2] >= 0 && box[3] <= width,
                "draw_parts: a window is partly outside the image");
        require(sprites.copies(i) > 0, "draw_parts: a part without copies");
        const int64_t its[] = {first.data()[i], hole.data()[i], end.data()[i]};
        require(ordered({its, {3}}, 0, static_cast<int64_t>(pieces.size()) - 1),
                "draw_parts: a polygon of a part is outside the array of pieces");
    }
    nb::gil_scoped_release others_may_run;
    raster::draw_parts(view(canvas), view(light), view(places), sprites, outlines);
}

}  // namespace

void bind_camera(nb::module_& m) {
    m.def("expose", expose, nb::arg(), nb::arg(), nb::arg(), nb::arg().noconvert());
    m.def("draw_plate", draw_plate, nb::arg().noconvert(), nb::arg(), nb::arg(), nb::arg(),
          nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg());
    m.def("draw_parts", draw_parts, nb::arg().noconvert(), nb::arg(), nb::arg(), nb::arg(),
          nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(),
          nb::arg(), nb::arg(), nb::arg(), nb::arg());
}

}  // namespace plate
