/* One tick of the learners, compiled: what agent/{basis,interaction,hjb,fpk}.py say, for the rows of a process.
 *
 * The Python form is the definition and the fallback. This one gives the same bits: every sum is taken in NumPy's
 * order (`sum_of`), nothing is contracted into fused operations, and the tables come from the Python classes.
 * Compiled without a compiler's leave to reorder floating point; with it, tests/agent/test_kernel.py fails.
 */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("default", "avx2"))) /* wider vectors, the same operations in each lane */
#else
#define WIDE
#endif

enum {
    SIZE = 4, AXES = 2, POWERS = 7, FLAT = SIZE * POWERS,
    PER_AXIS = 27, VALUES = AXES * PER_AXIS, BLOCKS = 4 * VALUES, /* σ_H and its three derivatives */
    PAIRS = 15, ALL_PAIRS = 8 * PAIRS, DENSITIES = 69, TERMS = DENSITIES + 1,
    PRODUCTS_MOST = 512, NODES = 64, NUMBERS = 5, BLOCK = 128
};

typedef struct {
    double scale[SIZE], value_factor[BLOCKS], pair_factor[ALL_PAIRS], factorial[TERMS];
    double monomials[TERMS * NODES], kernel[NODES];
    double c1, c2, c3, epsilon, mu_h, push, kappa, drag, wind[AXES], half_variance, gain, arrived_squared, mu_f;
    int32_t value_first[BLOCKS], value_second[BLOCKS], pair_first[ALL_PAIRS], pair_second[ALL_PAIRS];
    int32_t at_position[TERMS], at_velocity[TERMS], left[2 * DENSITIES], right[2 * DENSITIES];
    int32_t weight[PRODUCTS_MOST], term[PRODUCTS_MOST], starts[TERMS + 1];
    int learns_density;
} Tables;

/* NumPy's pairwise sum of contiguous doubles. */
static double pairwise(const double *a, Py_ssize_t n) {
    if (n < 8) {
        double sum = -0.0;
        for (Py_ssize_t i = 0; i < n; i++) sum += a[i];
        return sum;
    }
    if (n <= BLOCK) {
        double r[8];
        Py_ssize_t i = 8;
        memcpy(r, a, sizeof r);
        for (; i < n - n % 8; i += 8)
            for (int k = 0; k < 8; k++) r[k] += a[i + k];
        double sum = ((r[0] + r[1]) + (r[2] + r[3])) + ((r[4] + r[5]) + (r[6] + r[7]));
        for (; i < n; i++) sum += a[i];
        return sum;
    }
    Py_ssize_t half = n / 2;
    half -= half % 8;
    return pairwise(a, half) + pairwise(a + half, n - half);
}

/* np.sum over a contiguous last axis. */
static double sum_of(const double *a, Py_ssize_t n) { return 0.0 + pairwise(a, n); }

/* swarm.state.dot */
static double dot(const double *a, const double *b, int n) {
    double products[2 * (DENSITIES > VALUES ? DENSITIES : VALUES)];
    for (int i = 0; i < n; i++) products[i] = a[i] * b[i];
    return sum_of(products, n);
}

/* np.maximum: what is not a number stays so. */
static double at_least(double x, double least) { return x >= least || x != x ? x : least; }

static double plane(const double *a, const double *b) { return dot(a, b, AXES); }

/* agent.interaction.empirical, with β = 1 */
static double empirical(const Tables *t, const double *s, const double *known, Py_ssize_t n, double *products) {
    for (Py_ssize_t j = 0; j < n; j++, known += SIZE) {
        double dr[AXES] = {known[0] - s[0], known[1] - s[1]}, dv[AXES] = {known[2] - s[2], known[3] - s[3]};
        products[j] = plane(dv, dv) / (t->epsilon + plane(dr, dr));
    }
    return sum_of(products, n) / (double)n;
}

/* agent.interaction.Quadrature; terms: [1, σ_F] */
WIDE static double quadrature(const Tables *t, const double *weights, const double *terms) {
    double w[DENSITIES], s[TERMS], products[PRODUCTS_MOST], mass[NODES] = {0}, weighed[NODES];
    for (int k = 0; k < DENSITIES; k++) w[k] = weights[k] * t->factorial[k + 1];
    for (int k = 0; k < TERMS; k++) s[k] = terms[k] / t->factorial[k];
    for (int p = 0; p < t->starts[TERMS]; p++) products[p] = w[t->weight[p]] * s[t->term[p]];
    for (int k = 0; k < TERMS; k++) {
        const double *first = products + t->starts[k];
        int more = t->starts[k + 1] - t->starts[k] - 1;
        double coefficient = more ? first[0] + pairwise(first + 1, more) : first[0];
        for (int q = 0; q < NODES; q++) mass[q] += coefficient * t->monomials[k * NODES + q];
    }
    for (int q = 0; q < NODES; q++) mass[q] = at_least(mass[q], 0.0);
    for (int q = 0; q < NODES; q++) weighed[q] = mass[q] * t->kernel[q];
    return sum_of(weighed, NODES) / at_least(sum_of(mass, NODES), DBL_MIN);
}

/* agent.hjb.HjbLearner.step; numbers: [a_x, a_y, e_H, …]. Returns the curvature. */
static double value_step(const Tables *t, const double *s, const double *powers, double phi_g,
                         const double *weights, double *stepped, double *numbers) {
    double blocks[BLOCKS], gradient[2 * VALUES], before[AXES], drift[AXES], slope[AXES], by_position[AXES];
    for (int k = 0; k < BLOCKS; k++)
        blocks[k] = powers[t->value_first[k]] * powers[t->value_second[k]] * t->value_factor[k];
    const double *sigma = blocks, *by_r = blocks + VALUES, *by_v = blocks + 2 * VALUES, *bend = blocks + 3 * VALUES;

    for (int x = 0; x < AXES; x++) {
        before[x] = -t->gain * dot(by_v + x * PER_AXIS, weights + x * PER_AXIS, PER_AXIS);
        drift[x] = before[x] - t->drag * (s[2 + x] - t->wind[x]);
    }
    for (int x = 0; x < AXES; x++)
        for (int k = x * PER_AXIS; k < (x + 1) * PER_AXIS; k++)
            gradient[k] = bend[k] * t->half_variance + s[2 + x] * by_r[k] + drift[x] * by_v[k];
    memcpy(gradient + VALUES, sigma, VALUES * sizeof *sigma);

    double residual = dot(weights, gradient, 2 * VALUES);
    residual += t->c3 * plane(before, before);
    residual += plane(s + 2, s) / at_least(sqrt(plane(s, s)), DBL_MIN) + t->c1 * plane(s + 2, s + 2);
    residual += t->c2 * phi_g;

    double rate = t->mu_h * residual;
    for (int k = 0; k < 2 * VALUES; k++) stepped[k] = weights[k] - rate * gradient[k];
    for (int x = 0; x < AXES; x++) {
        by_position[x] = s[x] + t->kappa * s[2 + x];
        slope[x] = t->kappa * s[x] + s[2 + x];
    }
    if (plane(by_position, s + 2) + plane(slope, drift) > 0 && dot(s, s, SIZE) >= t->arrived_squared)
        for (int x = 0; x < AXES; x++)
            for (int k = x * PER_AXIS; k < (x + 1) * PER_AXIS; k++) stepped[k] += t->push * slope[x] * by_v[k];
    for (int x = 0; x < AXES; x++)
        numbers[x] = -t->gain * dot(by_v + x * PER_AXIS, stepped + x * PER_AXIS, PER_AXIS);
    numbers[AXES] = residual;
    return dot(bend, stepped, VALUES);
}

/* agent.fpk.FpkLearner.step; returns e_F. */
static double density_step(const Tables *t, const double *s, const double *pairs, const double *terms,
                           const double *action, double curvature, const double *weights, double *stepped) {
    double parts[4 * PAIRS], gradient[2 * DENSITIES], drift[AXES];
    double divergence = -2.0 * t->drag - t->gain * curvature, spread = -t->half_variance;
    const double *velocity = pairs + 3 * PAIRS;
    for (int x = 0; x < AXES; x++) drift[x] = action[x] - t->drag * (s[2 + x] - t->wind[x]);
    for (int k = 0; k < PAIRS; k++) {
        parts[k] = pairs[k];
        parts[PAIRS + k] = divergence * pairs[k] + s[2] * pairs[PAIRS + k] + s[3] * pairs[2 * PAIRS + k];
        parts[2 * PAIRS + k] = velocity[k];
        parts[3 * PAIRS + k] = drift[0] * velocity[PAIRS + k] + drift[1] * velocity[2 * PAIRS + k]
                             + spread * velocity[3 * PAIRS + k] + spread * velocity[4 * PAIRS + k];
    }
    for (int k = 0; k < DENSITIES; k++)
        gradient[k] = parts[t->left[k]] * parts[t->right[k]]
                    + parts[t->left[DENSITIES + k]] * parts[t->right[DENSITIES + k]];
    memcpy(gradient + DENSITIES, terms + 1, DENSITIES * sizeof *terms);
    double residual = dot(weights, gradient, 2 * DENSITIES), rate = t->mu_f * residual;
    for (int k = 0; k < 2 * DENSITIES; k++) stepped[k] = weights[k] - rate * gradient[k];
    return residual;
}

/* agent.learner.Learner.step for one row; known: (n, 4) for hjb. */
static void row_step(const Tables *t, const double *s, const double *known, Py_ssize_t n, double *scratch,
                     const double *value, const double *density, double *value_out, double *density_out,
                     double *numbers) {
    double powers[FLAT], pairs[ALL_PAIRS], terms[TERMS];
    for (int c = 0; c < SIZE; c++) {
        double u = s[c] / t->scale[c], power = 1.0;
        for (int k = 0; k < POWERS; k++, power *= u) powers[c * POWERS + k] = power;
    }
    if (!t->learns_density) {
        numbers[4] = empirical(t, s, known, n, scratch);
        value_step(t, s, powers, numbers[4], value, value_out, numbers);
        numbers[3] = 0.0;
        return;
    }
    for (int k = 0; k < ALL_PAIRS; k++)
        pairs[k] = powers[t->pair_first[k]] * powers[t->pair_second[k]] * t->pair_factor[k];
    for (int k = 0; k < TERMS; k++) terms[k] = pairs[t->at_position[k]] * pairs[3 * PAIRS + t->at_velocity[k]];
    numbers[4] = quadrature(t, density, terms);
    double curvature = value_step(t, s, powers, numbers[4], value, value_out, numbers);
    numbers[3] = density_step(t, s, pairs, terms, numbers, curvature, density, density_out);
}

/* ---- Python ---- */

static const char *NAME = "meanflock.tables";

static void forget(PyObject *capsule) { PyMem_Free(PyCapsule_GetPointer(capsule, NAME)); }

/* Copies exactly `count` items of `size` bytes out of entry `name` of a dict. */
static int copy_entry(PyObject *dict, const char *name, void *to, Py_ssize_t count, Py_ssize_t size) {
    PyObject *array = PyDict_GetItemString(dict, name);
    Py_buffer view;
    if (array == NULL) {
        PyErr_Format(PyExc_KeyError, "%s", name);
        return -1;
    }
    if (PyObject_GetBuffer(array, &view, PyBUF_C_CONTIGUOUS) < 0) return -1;
    int fits = view.len == count * size && view.itemsize == size;
    if (fits) memcpy(to, view.buf, view.len);
    else PyErr_Format(PyExc_ValueError, "%s: %zd bytes, expected %zd", name, view.len, count * size);
    PyBuffer_Release(&view);
    return fits ? 0 : -1;
}

static int all_below(const int32_t *index, int count, int end) {
    for (int k = 0; k < count; k++)
        if (index[k] < 0 || index[k] >= end) return 0;
    return 1;
}

static int sound(const Tables *t) {
    int ascending = t->starts[0] == 0;
    for (int k = 0; k < TERMS; k++) ascending = ascending && t->starts[k] < t->starts[k + 1];
    return ascending && all_below(t->value_first, BLOCKS, FLAT) && all_below(t->value_second, BLOCKS, FLAT)
        && all_below(t->pair_first, ALL_PAIRS, FLAT) && all_below(t->pair_second, ALL_PAIRS, FLAT)
        && all_below(t->at_position, TERMS, PAIRS) && all_below(t->at_velocity, TERMS, PAIRS)
        && all_below(t->left, 2 * DENSITIES, 4 * PAIRS) && all_below(t->right, 2 * DENSITIES, 4 * PAIRS)
        && all_below(t->weight, t->starts[TERMS], DENSITIES) && all_below(t->term, t->starts[TERMS], TERMS);
}

static int outside(void) {
    PyErr_SetString(PyExc_ValueError, "an index of the tables points outside of them");
    return -1;
}

static PyObject *tables(PyObject *module, PyObject *dict) {
    if (!PyDict_Check(dict)) return PyErr_Format(PyExc_TypeError, "tables come as a dict");
    Tables *t = PyMem_Calloc(1, sizeof *t);
    if (t == NULL) return PyErr_NoMemory();
    double learns = 0.0;
    int32_t products = 0;
    int failed = copy_entry(dict, "starts", t->starts, TERMS + 1, 4);
    if (!failed && t->starts[TERMS] >= 0 && t->starts[TERMS] <= PRODUCTS_MOST) products = t->starts[TERMS];
    else if (!failed) failed = outside();
#define DOUBLES(field, count) || copy_entry(dict, #field, t->field, count, 8)
#define INDICES(field, count) || copy_entry(dict, #field, t->field, count, 4)
#define NUMBER(field) || copy_entry(dict, #field, &t->field, 1, 8)
    failed = failed DOUBLES(scale, SIZE) DOUBLES(value_factor, BLOCKS) DOUBLES(pair_factor, ALL_PAIRS)
        DOUBLES(factorial, TERMS) DOUBLES(monomials, TERMS * NODES) DOUBLES(kernel, NODES) DOUBLES(wind, AXES)
        NUMBER(c1) NUMBER(c2) NUMBER(c3) NUMBER(epsilon) NUMBER(mu_h) NUMBER(push) NUMBER(kappa) NUMBER(drag)
        NUMBER(half_variance) NUMBER(gain) NUMBER(arrived_squared) NUMBER(mu_f)
        INDICES(value_first, BLOCKS) INDICES(value_second, BLOCKS) INDICES(pair_first, ALL_PAIRS)
        INDICES(pair_second, ALL_PAIRS) INDICES(at_position, TERMS) INDICES(at_velocity, TERMS)
        INDICES(left, 2 * DENSITIES) INDICES(right, 2 * DENSITIES) INDICES(weight, products) INDICES(term, products)
        || copy_entry(dict, "learns_density", &learns, 1, 8);
    if (!failed && !sound(t)) failed = outside();
    t->learns_density = learns != 0.0;
    PyObject *capsule = failed ? NULL : PyCapsule_New(t, NAME, forget);
    if (capsule == NULL) PyMem_Free(t);
    return capsule;
}

static PyObject *step(PyObject *module, PyObject *args) {
    enum { STATES, VALUE, DENSITY, KNOWN, VALUE_OUT, DENSITY_OUT, NUMBERS_OUT, ARRAYS };
    PyObject *capsule, *array[ARRAYS], *result = NULL;
    if (!PyArg_ParseTuple(args, "OOOOOOOO:step", &capsule, &array[STATES], &array[VALUE], &array[DENSITY],
                          &array[KNOWN], &array[VALUE_OUT], &array[DENSITY_OUT], &array[NUMBERS_OUT]))
        return NULL;
    const Tables *t = PyCapsule_GetPointer(capsule, NAME);
    if (t == NULL) return NULL;
    Py_buffer view[ARRAYS];
    double *scratch = NULL;
    int held = 0;
    for (; held < ARRAYS; held++) {
        int flags = PyBUF_C_CONTIGUOUS | (held >= VALUE_OUT ? PyBUF_WRITABLE : 0);
        if (array[held] == Py_None && held == KNOWN) memset(&view[held], 0, sizeof view[held]);
        else if (PyObject_GetBuffer(array[held], &view[held], flags) < 0) goto done;
    }
    const Py_ssize_t d = sizeof(double), rows = view[STATES].len / (SIZE * d);
    const Py_ssize_t others = rows ? view[KNOWN].len / (rows * SIZE * d) : 0;
    const Py_ssize_t expected[ARRAYS] = {
        rows * SIZE, rows * 2 * VALUES, rows * 2 * DENSITIES, rows * others * SIZE,
        rows * 2 * VALUES, rows * 2 * DENSITIES, rows * NUMBERS,
    };
    for (int k = 0; k < ARRAYS; k++)
        if (view[k].len != expected[k] * d || (view[k].buf != NULL && view[k].itemsize != d)) {
            PyErr_Format(PyExc_ValueError, "array %d has %zd bytes, expected %zd", k, view[k].len, expected[k] * d);
            goto done;
        }
    if (!t->learns_density) {
        if (rows && !others) {
            PyErr_SetString(PyExc_ValueError, "hjb needs the states its rows know");
            goto done;
        }
        scratch = PyMem_Malloc((others ? others : 1) * d);
        if (scratch == NULL) {
            PyErr_NoMemory();
            goto done;
        }
    }
    const double *states = view[STATES].buf, *value = view[VALUE].buf, *density = view[DENSITY].buf;
    const double *known = view[KNOWN].buf;
    double *value_out = view[VALUE_OUT].buf, *density_out = view[DENSITY_OUT].buf, *numbers = view[NUMBERS_OUT].buf;
    for (Py_ssize_t m = 0; m < rows; m++)
        row_step(t, states + m * SIZE, t->learns_density ? NULL : known + m * others * SIZE, others, scratch,
                 value + m * 2 * VALUES, density + m * 2 * DENSITIES, value_out + m * 2 * VALUES,
                 density_out + m * 2 * DENSITIES, numbers + m * NUMBERS);
    double largest = 0.0; /* and what is not a number stays so */
    for (Py_ssize_t k = 0; k < rows * NUMBERS && largest == largest; k++) {
        double size = fabs(numbers[k]);
        if (!(size <= largest)) largest = size;
    }
    result = PyFloat_FromDouble(largest);
done:
    PyMem_Free(scratch);
    while (held--)
        if (view[held].obj != NULL) PyBuffer_Release(&view[held]);
    return result;
}

/* Whether a buffer holds exactly this many contiguous doubles; the view is to be released if so. */
static int holds(PyObject *array, Py_buffer *view, int flags, Py_ssize_t doubles) {
    if (PyObject_GetBuffer(array, view, PyBUF_C_CONTIGUOUS | flags) < 0) {
        PyErr_Clear();
        return 0;
    }
    if (view->len == doubles * (Py_ssize_t)sizeof(double) && view->itemsize == sizeof(double)) return 1;
    PyBuffer_Release(view);
    return 0;
}

typedef struct { const char *text; Py_ssize_t size; } Text;

static char *put(char *end, const void *what, Py_ssize_t size) {
    memcpy(end, what, size);
    return end + size;
}

static PyObject *answer(PyObject *module, PyObject *args) {
    enum { VALUE, DENSITY, VALUE_OUT, DENSITY_OUT, ARRAYS };
    PyObject *capsule, *frame, *array[ARRAYS], *act = NULL;
    Text raw, before, after, say[3] = {{NULL, 0}}; /* around the states; around the outcome and, if any, the report */
    double bound;
    if (!PyArg_ParseTuple(args, "Oy#(y#y#)O!dOOOO:answer", &capsule, &raw.text, &raw.size, &before.text, &before.size,
                          &after.text, &after.size, &PyTuple_Type, &frame, &bound, &array[VALUE], &array[DENSITY],
                          &array[VALUE_OUT], &array[DENSITY_OUT])
        || !PyArg_ParseTuple(frame, "y#y#|y#:act", &say[0].text, &say[0].size, &say[1].text, &say[1].size, &say[2].text,
                             &say[2].size))
        return NULL;
    const Tables *t = PyCapsule_GetPointer(capsule, NAME);
    if (t == NULL) return NULL;
    const Py_ssize_t d = sizeof(double), in = SIZE * d, out = NUMBERS * d, v = 2 * VALUES, f = 2 * DENSITIES;
    const Py_ssize_t brought = raw.size - before.size - after.size, rows = brought / in;
    if (!t->learns_density || brought <= 0 || brought % in || memcmp(raw.text, before.text, before.size)
        || memcmp(raw.text + raw.size - after.size, after.text, after.size))
        Py_RETURN_NONE;
    Py_buffer view[ARRAYS];
    int views = 0;
    for (; views < ARRAYS; views++) {
        Py_ssize_t doubles = rows * (views == VALUE || views == VALUE_OUT ? v : f);
        if (!holds(array[views], &view[views], views >= VALUE_OUT ? PyBUF_WRITABLE : 0, doubles)) break;
    }
    int inside = views == ARRAYS;
    if (inside) {
        Py_ssize_t size = say[0].size + rows * out + say[1].size;
        if (say[2].text != NULL) size += rows * (v + f) * d + say[2].size;
        inside = (act = PyBytes_FromStringAndSize(NULL, size)) != NULL;
    }
    char *end = inside ? put(PyBytes_AsString(act), say[0].text, say[0].size) : NULL;
    for (Py_ssize_t m = 0; m < rows && inside; m++) {
        double s[SIZE], numbers[NUMBERS];
        memcpy(s, raw.text + before.size + m * in, in);
        for (int c = 0; c < SIZE; c++) inside = inside && isfinite(s[c]);
        if (!inside) break;
        row_step(t, s, NULL, 0, NULL, (double *)view[VALUE].buf + m * v, (double *)view[DENSITY].buf + m * f,
                 (double *)view[VALUE_OUT].buf + m * v, (double *)view[DENSITY_OUT].buf + m * f, numbers);
        for (int k = 0; k < NUMBERS; k++) inside = inside && fabs(numbers[k]) < bound; /* NaN is below nothing */
        end = put(end, numbers, out);
    }
    if (inside) end = put(end, say[1].text, say[1].size);
    if (inside && say[2].text != NULL) {
        for (Py_ssize_t m = 0; m < rows; m++) { /* agent.minds.Minds.models */
            end = put(end, (double *)view[VALUE_OUT].buf + m * v, v * d);
            end = put(end, (double *)view[DENSITY_OUT].buf + m * f, f * d);
        }
        put(end, say[2].text, say[2].size);
    }
    while (views--) PyBuffer_Release(&view[views]);
    if (inside) return act;
    Py_XDECREF(act);
    if (PyErr_Occurred()) return NULL;
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {
    {"tables", tables, METH_O, "Tables of a scenario, from a dict of arrays; checked once."},
    {"step", step, METH_VARARGS,
     "step(tables, states, value, density, known | None, value_out, density_out, numbers_out)\n\n"
     "All float64, rows first. Returns the largest of the numbers, or NaN."},
    {"answer", answer, METH_VARARGS,
     "answer(tables, raw, (before, after), (before, after[, end]), bound, value, density, value_out, density_out)\n\n"
     "The bytes of an Act to a plain Sense, with a report of the models where there is an end; None where it is not a\n"
     "plain Sense, or where a number is not below the bound."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_kernel", "The learners' tick, compiled.", 0, methods};

PyMODINIT_FUNC PyInit__kernel(void) { return PyModule_Create(&definition); }
