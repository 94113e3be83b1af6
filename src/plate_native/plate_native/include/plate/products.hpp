// Products of small matrices. The order of summation does not depend on the processor's vector
// width. Vector instructions compute several columns of a row together. The terms of each sum are
// added one by one, in the order of the source code.
#pragma once
#include <algorithm>

#include "wide.hpp"

namespace plate {

// Number of values of a type in a vector register of 256 bits.
template <class Number>
constexpr int LANES_OF = 32 / sizeof(Number);

// Computes a tile of HIGH rows and WIDE columns of a' b, which is the sum over k of a[k] b[k]'. The
// tile is small enough to stay in the processor's registers.
template <int HIGH, int WIDE, class Number>
[[gnu::always_inline]] inline void product_tile(const Number* __restrict a, int a_row, const Number* __restrict b,
                                                int b_row, int terms, Number* __restrict result, int result_row) {
    Number sum[HIGH][WIDE] = {};
    for (int k = 0; k < terms; k++, a += a_row, b += b_row)
#pragma GCC unroll 8
        for (int i = 0; i < HIGH; i++)
#pragma GCC unroll 32
            for (int j = 0; j < WIDE; j++) sum[i][j] += a[i] * b[j];
    for (int i = 0; i < HIGH; i++)
        for (int j = 0; j < WIDE; j++) result[i * result_row + j] = sum[i][j];
}

// Computes HIGH rows of a' b, in tiles with a width of at most VECTORS vector registers.
template <int HIGH, int VECTORS, class Number>
[[gnu::always_inline]] inline void product_rows(const Number* a, int a_row, const Number* b, int b_row, int terms,
                                                int wide, Number* result, int result_row) {
    constexpr int ONE = LANES_OF<Number>, WIDE = VECTORS * ONE;
    int j = 0;
    for (; j + WIDE <= wide; j += WIDE)
        product_tile<HIGH, WIDE>(a, a_row, b + j, b_row, terms, result + j, result_row);
    for (; j + ONE <= wide; j += ONE)
        product_tile<HIGH, ONE>(a, a_row, b + j, b_row, terms, result + j, result_row);
    for (; j < wide; j++) product_tile<HIGH, 1>(a, a_row, b + j, b_row, terms, result + j, result_row);
}

template <class Number>
[[gnu::always_inline]] inline void product_of(const Number* a, int a_row, const Number* b, int b_row, int terms,
                                              int high, int wide, Number* result, int result_row) {
    int i = 0;
    for (; i + 6 <= high; i += 6)
        product_rows<6, 2>(a + i, a_row, b, b_row, terms, wide, result + i * result_row, result_row);
    for (; i + 3 <= high; i += 3)
        product_rows<3, 4>(a + i, a_row, b, b_row, terms, wide, result + i * result_row, result_row);
    for (; i < high; i++)
        product_rows<1, 4>(a + i, a_row, b, b_row, terms, wide, result + i * result_row, result_row);
}

template <class Number>
[[gnu::always_inline]] inline void square_product_of(const Number* a, int a_row, int terms, int count,
                                                     Number* result) {
    int i = 0;
    for (; i + 6 <= count; i += 6) {
        const int from = i / LANES_OF<Number> * LANES_OF<Number>;
        product_rows<6, 2>(a + i, a_row, a + from, a_row, terms, count - from, result + i * count + from, count);
    }
    for (; i < count; i++) {
        const int from = i / LANES_OF<Number> * LANES_OF<Number>;
        product_rows<1, 4>(a + i, a_row, a + from, a_row, terms, count - from, result + i * count + from, count);
    }
}

// Computes `result` (high, wide) = a' b, which is the sum over k of a[k] b[k]'. `a_row`, `b_row`
// and `result_row` are the distances between consecutive rows of the matrices, in numbers.
PLATE_WIDE inline void product(const double* a, int a_row, const double* b, int b_row, int terms, int high, int wide,
                               double* result, int result_row) {
    product_of(a, a_row, b, b_row, terms, high, wide, result, result_row);
}

PLATE_WIDE inline void product(const float* a, int a_row, const float* b, int b_row, int terms, int high, int wide,
                               float* result, int result_row) {
    product_of(a, a_row, b, b_row, terms, high, wide, result, result_row);
}

// Computes the upper half of a' a (count, count). Entries below the diagonal are also computed if
// their tile contains entries of the upper half.
PLATE_WIDE inline void square_product(const double* a, int a_row, int terms, int count, double* result) {
    square_product_of(a, a_row, terms, count, result);
}

PLATE_WIDE inline void square_product(const float* a, int a_row, int terms, int count, float* result) {
    square_product_of(a, a_row, terms, count, result);
}

}  // namespace plate
