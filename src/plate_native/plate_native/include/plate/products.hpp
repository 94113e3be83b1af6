// Products of small matrices whose sums have one order, whatever the processor's vectors are.
//
// Vector instructions go along a row of the result, so each sum is done term by term, as written.
#pragma once
#include <algorithm>

#include "wide.hpp"

namespace plate {

// A tile of HIGH rows and WIDE columns of the sum over k of a[k] b[k]', kept in registers.
template <int HIGH, int WIDE>
[[gnu::always_inline]] inline void product_tile(const double* __restrict a, int a_row, const double* __restrict b, int b_row,
                         int terms, double* __restrict result, int result_row) {
    double sum[HIGH][WIDE] = {};
    for (int k = 0; k < terms; k++, a += a_row, b += b_row)
#pragma GCC unroll 8
        for (int i = 0; i < HIGH; i++)
#pragma GCC unroll 16
            for (int j = 0; j < WIDE; j++) sum[i][j] += a[i] * b[j];
    for (int i = 0; i < HIGH; i++)
        for (int j = 0; j < WIDE; j++) result[i * result_row + j] = sum[i][j];
}

// HIGH rows of a result, in tiles of at most WIDE columns.
template <int HIGH, int WIDE>
[[gnu::always_inline]] inline void product_rows(const double* a, int a_row, const double* b, int b_row, int terms,
                                                int wide, double* result, int result_row) {
    int j = 0;
    for (; j + WIDE <= wide; j += WIDE)
        product_tile<HIGH, WIDE>(a, a_row, b + j, b_row, terms, result + j, result_row);
    for (; j + 4 <= wide; j += 4) product_tile<HIGH, 4>(a, a_row, b + j, b_row, terms, result + j, result_row);
    for (; j < wide; j++) product_tile<HIGH, 1>(a, a_row, b + j, b_row, terms, result + j, result_row);
}

// result (high, wide) = the sum over k of a[k] b[k]': a' b. Rows are `.._row` numbers apart.
PLATE_WIDE inline void product(const double* a, int a_row, const double* b, int b_row, int terms, int high, int wide,
                               double* result, int result_row) {
    int i = 0;
    for (; i + 6 <= high; i += 6)
        product_rows<6, 8>(a + i, a_row, b, b_row, terms, wide, result + i * result_row, result_row);
    for (; i + 3 <= high; i += 3)
        product_rows<3, 16>(a + i, a_row, b, b_row, terms, wide, result + i * result_row, result_row);
    for (; i < high; i++)
        product_rows<1, 16>(a + i, a_row, b, b_row, terms, wide, result + i * result_row, result_row);
}

// The upper half of a' a (count, count), and the rest of its tiles.
PLATE_WIDE inline void square_product(const double* a, int a_row, int terms, int count, double* result) {
    int i = 0;
    for (; i + 6 <= count; i += 6)
        product_rows<6, 8>(a + i, a_row, a + i, a_row, terms, count - i, result + i * count + i, count);
    for (; i < count; i++)
        product_rows<1, 16>(a + i, a_row, a + i, a_row, terms, count - i, result + i * count + i, count);
}

}  // namespace plate
