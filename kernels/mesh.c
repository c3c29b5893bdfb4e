/* Compiled form of mesh.py: the same operations in the same order, and integers in any order. */
#define LANES 1
#include "native.h"

#include <math.h>
#include <string.h>

#include "pairwise.h"

enum { SIDE = 256, PERIOD = 2 * SIDE, HALF = PERIOD / 2 + 1, POINTS = 8, BEFORE = 3, CELL = 2, CELLS = SIDE / CELL };
enum { ROWS = 6, PLACES = (CELLS + ROWS) * CELLS }; /* of cells: in reach of one, and all */
enum { WIDTH = 8, COLUMNS = (HALF + WIDTH - 1) / WIDTH * WIDTH }; /* columns that are transformed at once */
enum { BLOCK = 1024, LANE = 16 }; /* near points whose integers one sum holds; and a multiple of the lanes of a vector */
static const double CENTRE = 127.5, RADIUS = 12.0, SELF = 12.0 * (429.0 / 2048), UNIT = 1048576.0;
static const double INVERSE[] = {-1.0 / 5040, 1.0 / 720, -1.0 / 240, 1.0 / 144, -1.0 / 144, 1.0 / 240, -1.0 / 720, 1.0 / 5040};
static const int REACH[] = {5, 5, 5, 5, 4, 3};

/* P of mesh.py, in the precision of t. */
#define TAYLOR(name, real)                                                               \
    static inline real name(real t) {                                                    \
        const real beyond = t - (real)1.0;                                               \
        real sum = (real)(33.0 / 2048);                                                  \
        sum = sum * beyond + (real)(-21.0 / 1024), sum = sum * beyond + (real)(7.0 / 256); \
        sum = sum * beyond + (real)(-5.0 / 128), sum = sum * beyond + (real)(1.0 / 16);  \
        sum = sum * beyond + (real)(-1.0 / 8), sum = sum * beyond + (real)(1.0 / 2);     \
        return sum * beyond + (real)1.0;                                                 \
    }
TAYLOR(taylor, double)
TAYLOR(taylor_single, float)

typedef struct { /* complex columns */
    double real[PERIOD][WIDTH], imaginary[PERIOD][WIDTH];
} Strip;

typedef struct { /* working memory of a transform */
    double values[PERIOD * PERIOD]; /* that are transformed, y then x */
    double real[PERIOD][COLUMNS], imaginary[PERIOD][COLUMNS]; /* transformed along y: x, then frequencies of y */
    Strip strip[2];
} Field;

typedef struct { /* points in the order of their cells, in units of RADIUS */
    int32_t *starts, *cell; /* the first point of each cell; and the cell of each point, in the order of the points */
    float *x, *y, *near_x, *near_y; /* the points; and those near to one cell */
} Cells;

/* Constants that the first call computes. */
static double cosine[HALF], sine[HALF], spectrum[PERIOD][COLUMNS];

ptrdiff_t mesh_room(ptrdiff_t n) {
    return (ptrdiff_t)(sizeof(Field) / sizeof(double)) + (PLACES + 2 + 5 * n + 2 * LANE) / 2 + 1;
}

/* ---- the smooth part ---- */

/* A step of Stockham's transform of the columns of a strip. */
INLINE void turn(const Strip *__restrict from, Strip *__restrict to, int stride) {
    const int half = PERIOD / 2 / stride;
    for (int j = 0; j < half; j++) {
        const double c = cosine[j * stride], s = sine[j * stride];
        for (int k = 0; k < stride; k++) {
            const int first = j * stride + k, second = first + PERIOD / 2, sum = first + j * stride, turned = sum + stride;
            for (int w = 0; w < WIDTH; w++) {
                const double real = from->real[first][w] - from->real[second][w];
                const double imaginary = from->imaginary[first][w] - from->imaginary[second][w];
                to->real[sum][w] = from->real[first][w] + from->real[second][w];
                to->imaginary[sum][w] = from->imaginary[first][w] + from->imaginary[second][w];
                to->real[turned][w] = real * c - imaginary * s;
                to->imaginary[turned][w] = real * s + imaginary * c;
            }
        }
    }
}

/* Fourier transform of the columns of strip[0], to strip[1] after an odd number of steps. */
static WIDE_TARGET void fourier(Strip *strip) {
    turn(strip, strip + 1, 1);
    for (int stride = 2; stride < PERIOD; stride *= 4) {
        turn(strip + 1, strip, stride);
        turn(strip, strip + 1, 2 * stride);
    }
}

/* Transforms side × side values along y. */
static void transform_y(Field *field, int side) {
    Strip *strip = field->strip;
    for (int x = 0; x < side; x += WIDTH) {
        memset(strip, 0, sizeof *strip);
        for (int y = 0; y < side; y++) memcpy(strip->real[y], field->values + y * side + x, sizeof strip->real[y]);
        fourier(strip);
        for (int w = 0; w < WIDTH; w++)
            for (int y = 0; y < COLUMNS; y++) {
                field->real[x + w][y] = strip[1].real[y][w];
                field->imaginary[x + w][y] = strip[1].imaginary[y][w];
            }
    }
}

/* Transforms WIDTH frequencies of y, from `y` on, along x; returns the result. */
static const Strip *transform_x(Field *field, int side, int y) {
    Strip *strip = field->strip;
    memset(strip, 0, sizeof *strip);
    for (int x = 0; x < side; x++) {
        memcpy(strip->real[x], field->real[x] + y, sizeof strip->real[x]);
        memcpy(strip->imaginary[x], field->imaginary[x] + y, sizeof strip->imaginary[x]);
    }
    fourier(strip);
    return strip + 1;
}

/* Computes the roots of one and the spectrum of L. */
static void prepare(Field *field) {
    cosine[0] = 1.0, sine[HALF / 2] = -1.0, cosine[HALF - 1] = -1.0;
    for (int step = HALF / 4; step; step /= 2)
        for (int j = step; j < HALF; j += 2 * step) {
            const double c = cosine[j - step] + cosine[j + step], s = sine[j - step] + sine[j + step];
            const double length = sqrt(c * c + s * s);
            cosine[j] = c / length, sine[j] = s / length;
        }
    for (int y = 0; y < PERIOD; y++)
        for (int x = 0; x < PERIOD; x++) {
            const double along = x < PERIOD - x ? x : PERIOD - x, across = y < PERIOD - y ? y : PERIOD - y;
            const double squared = along * along + across * across, radius = RADIUS * RADIUS;
            field->values[y * PERIOD + x] = squared < radius ? RADIUS * taylor(squared / radius) : sqrt(squared);
        }
    transform_y(field, PERIOD);
    for (int y = 0; y < COLUMNS; y += WIDTH) {
        const Strip *transformed = transform_x(field, PERIOD, y);
        for (int x = 0; x < PERIOD; x++)
            for (int w = 0; w < WIDTH; w++) {
                const double twice = y + w > 0 && y + w < HALF - 1 ? 2.0 : 1.0; /* frequencies that stand for two */
                spectrum[x][y + w] = twice * transformed->real[x][w] / (double)(PERIOD * PERIOD);
            }
    }
}

/* Lagrange's weights of the nodes around a point that is a part of the spacing beyond a node. */
static void weigh(double part, double *weights) {
    double product = 1.0;
    for (int k = 0; k < POINTS; k++) weights[k] = product, product *= part - (k - BEFORE);
    product = 1.0;
    for (int k = POINTS - 1; k >= 0; k--) weights[k] = weights[k] * product * INVERSE[k], product *= part - (k - BEFORE);
}

static WIDE_TARGET void spread(ptrdiff_t n, const double *x, const double *y, double *__restrict values) {
    memset(values, 0, SIDE * SIDE * sizeof *values);
    for (ptrdiff_t i = 0; i < n; i++) {
        double along[POINTS], across[POINTS];
        const double first_x = floor(x[i]), first_y = floor(y[i]);
        weigh(x[i] - first_x, along), weigh(y[i] - first_y, across);
        double *node = values + ((ptrdiff_t)first_y - BEFORE) * SIDE + (ptrdiff_t)first_x - BEFORE;
        for (int k = 0; k < POINTS; k++, node += SIDE)
            for (int m = 0; m < POINTS; m++) node[m] += across[k] * along[m];
    }
}

/* Σ w_g w_h L(‖g − h‖) over all ordered pairs of nodes, whose weights are the values. */
static double energy(Field *field) {
    double sums[COLUMNS] = {0.0};
    transform_y(field, SIDE);
    for (int y = 0; y < COLUMNS; y += WIDTH) {
        const Strip *transformed = transform_x(field, SIDE, y);
        for (int x = 0; x < PERIOD; x++)
            for (int w = 0; w < WIDTH; w++) {
                const double real = transformed->real[x][w], imaginary = transformed->imaginary[x][w];
                sums[y + w] += (real * real + imaginary * imaginary) * spectrum[x][y + w];
            }
    }
    return sum_of(sums, HALF);
}

/* ---- near pairs ---- */

/* Sorts the points by their cells. */
static void sort(ptrdiff_t n, const double *x, const double *y, const Cells *cells) {
    int32_t *next = cells->starts + 1;
    memset(cells->starts, 0, (PLACES + 2) * sizeof *next);
    for (ptrdiff_t i = 0; i < n; i++) {
        cells->cell[i] = (int32_t)y[i] / CELL * CELLS + (int32_t)x[i] / CELL;
        next[cells->cell[i] + 1]++;
    }
    for (int c = 0; c < PLACES; c++) next[c + 1] += next[c];
    for (ptrdiff_t i = 0; i < n; i++) { /* `next` ends as the starts of the next cells */
        const int32_t place = next[cells->cell[i]]++;
        cells->x[place] = (float)((x[i] - CENTRE) / RADIUS), cells->y[place] = (float)((y[i] - CENTRE) / RADIUS);
    }
}

/* First point of the row-th next row of cells that is near to a cell, and the one after the last. */
static int32_t begin(const Cells *cells, int c, int row) { return cells->starts[row ? c + row * CELLS - REACH[row] : c]; }
static int32_t end(const Cells *cells, int c, int row) { return cells->starts[c + row * CELLS + REACH[row] + 1]; }

/* Number of near pairs. */
static int64_t near_pairs(const Cells *cells) {
    int64_t pairs = 0;
    for (int c = 0; c < PLACES - ROWS * CELLS; c++) {
        const int64_t here = cells->starts[c + 1] - cells->starts[c];
        if (!here) continue;
        pairs -= here * (here + 1) / 2;
        for (int row = 0; row < ROWS; row++) pairs += here * (end(cells, c, row) - begin(cells, c, row));
    }
    return pairs;
}

/* Σ n(r)/R of near pairs, in units of 1/UNIT. */
static WIDE_TARGET int64_t near(const Cells *cells) {
    int64_t total = 0;
    for (int c = 0; c < PLACES - ROWS * CELLS; c++) {
        const int32_t here = cells->starts[c + 1] - cells->starts[c];
        float *__restrict x = cells->near_x, *__restrict y = cells->near_y;
        int32_t count = 0;
        for (int row = 0; here && row < ROWS; row++) {
            const int32_t from = begin(cells, c, row), points = end(cells, c, row) - from;
            memcpy(x + count, cells->x + from, points * sizeof *x);
            memcpy(y + count, cells->y + from, points * sizeof *y);
            count += points;
        }
        for (int k = 0; k < LANE; k++) x[count + k] = y[count + k] = 1e15f; /* beyond R, to fill a vector */
        for (int32_t i = 0; i < here; i++)
            for (int32_t j = i + 1; j < count; j += BLOCK) {
                const int32_t left = count - j < BLOCK ? (count - j + LANE - 1) / LANE * LANE : BLOCK;
                int32_t sum = 0;
                for (int32_t k = j; k < j + left; k++) {
                    const float along = x[k] - x[i], across = y[k] - y[i], squared = along * along + across * across;
                    const float t = squared < 1.0f ? squared : 1.0f;
                    sum += (int32_t)((taylor_single(t) - sqrtf(t)) * (float)UNIT + 0.5f);
                }
                total += sum;
            }
    }
    return total;
}

double mesh_distances(ptrdiff_t n, const double *x, const double *y, double *room) {
    static int prepared;
    Field *field = (Field *)room;
    int32_t *starts = (int32_t *)(field + 1), *cell = starts + PLACES + 2;
    float *sorted = (float *)(cell + n), *near_points = sorted + 2 * n;
    const Cells cells = {starts, cell, sorted, sorted + n, near_points, near_points + n + LANE};
    sort(n, x, y, &cells);
    if (4 * near_pairs(&cells) > (int64_t)n * n) return -1.0;
    if (!prepared) prepare(field), prepared = 1;
    spread(n, x, y, field->values);
    const double smooth = 0.5 * (energy(field) - (double)n * SELF);
    return smooth - RADIUS * ((double)near(&cells) / UNIT);
}
