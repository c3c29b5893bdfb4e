/* What fading.py says: the same operations in the same order. */
#include "module.h"

#include <stdint.h>
#include <string.h>

static void put(char *array, Py_ssize_t place, int64_t number) {
    memcpy(array + place * (Py_ssize_t)sizeof number, &number, sizeof number);
}

/* One more array of int64, to be written; NULL and an exception where it is none. */
static char *integers(Arrays *arrays, PyObject *array, const char *name, Py_ssize_t *count) {
    Py_buffer *view = hold(arrays, array, name, "lq", sizeof(int64_t), WRITTEN);
    if (view == NULL) return NULL;
    *count = view->len / (Py_ssize_t)sizeof(int64_t);
    return view->buf;
}

/* Whether each of the first `count` busy links is one of L. */
static int all_below(const char *line, Py_ssize_t count, Py_ssize_t links) {
    for (Py_ssize_t i = 0; i < count; i++)
        if ((uint64_t)index_at(line, i) >= (uint64_t)links) return 0;
    return 1;
}

/* Counts a slot of a link; returns whether the link is still busy. */
static int counted(int is_good, long long slot, int64_t link, char *need, char *took) {
    const int64_t needs = index_at(need, link) - is_good;
    put(need, link, needs);
    put(took, link, slot);
    return needs > 0;
}

PyObject *radio_fade(PyObject *module, PyObject *args) {
    PyObject *normal, *thresholds, *busy, *missing, *slots;
    Arrays arrays = {.held = 0};
    double xi, chi;
    long long slot;
    Py_ssize_t links, each, places;
    if (!PyArg_ParseTuple(args, "OddOLOOO:fade", &normal, &xi, &chi, &thresholds, &slot, &busy, &missing, &slots))
        return NULL;
    const Py_ssize_t count = items(&arrays, normal, "normal", 1, 2);
    const Py_ssize_t bounds = count < 0 ? -1 : items(&arrays, thresholds, "thresholds", 1, 1);
    char *line = bounds < 0 ? NULL : integers(&arrays, busy, "busy", &places);
    char *need = line == NULL ? NULL : integers(&arrays, missing, "missing", &each);
    char *took = need == NULL ? NULL : integers(&arrays, slots, "slots", &links);
    if (took == NULL) return done(&arrays, NULL);
    const int fit = count <= places && each == links && (bounds == 1 || bounds == links);
    if (!fit || !all_below(line, count, links)) {
        PyErr_SetString(PyExc_ValueError, "fade: not a link for each row of normal numbers");
        return done(&arrays, NULL);
    }
    const char *draws = arrays.view[0].buf, *least = arrays.view[1].buf;
    Py_ssize_t left = 0;
    for (Py_ssize_t i = 0; i < count; i++) {
        const int64_t link = index_at(line, i);
        const double along = double_at(draws, 2 * i) * chi + xi, across = double_at(draws, 2 * i + 1) * chi;
        const double squared = along * along + across * across;
        const int is_good = squared >= double_at(least, bounds == 1 ? 0 : link);
        if (counted(is_good, slot, link, need, took)) put(line, left++, link);
    }
    return done(&arrays, PyLong_FromSsize_t(left));
}

PyObject *radio_send(PyObject *module, PyObject *args) {
    PyObject *uniform, *success, *busy, *missing, *slots;
    Arrays arrays = {.held = 0};
    long long slot;
    Py_ssize_t links, each, places;
    if (!PyArg_ParseTuple(args, "OOLOOO:send", &uniform, &success, &slot, &busy, &missing, &slots)) return NULL;
    const Py_ssize_t count = items(&arrays, uniform, "uniform", 1, 1);
    const Py_ssize_t chances = count < 0 ? -1 : items(&arrays, success, "success", 1, 1);
    char *line = chances < 0 ? NULL : integers(&arrays, busy, "busy", &places);
    char *need = line == NULL ? NULL : integers(&arrays, missing, "missing", &each);
    char *took = need == NULL ? NULL : integers(&arrays, slots, "slots", &links);
    if (took == NULL) return done(&arrays, NULL);
    if (count > places || each != links || chances != links || !all_below(line, count, links)) {
        PyErr_SetString(PyExc_ValueError, "send: not a link for each uniform number");
        return done(&arrays, NULL);
    }
    const char *draws = arrays.view[0].buf, *chance = arrays.view[1].buf;
    Py_ssize_t left = 0;
    for (Py_ssize_t i = 0; i < count; i++) {
        const int64_t link = index_at(line, i);
        if (counted(double_at(draws, i) < double_at(chance, link), slot, link, need, took)) put(line, left++, link);
    }
    return done(&arrays, PyLong_FromSsize_t(left));
}

PyObject *radio_poisson(PyObject *module, PyObject *args) {
    PyObject *rates, *first, *reached, *sums;
    Arrays arrays = {.held = 0};
    Py_ssize_t terms;
    double *room;
    if (!PyArg_ParseTuple(args, "OOnOO:poisson", &rates, &first, &terms, &reached, &sums)) return NULL;
    const Py_ssize_t count = items(&arrays, rates, "rates", 1, 1);
    if (count < 0 || !doubles(&arrays, first, "first", count, READ)) return done(&arrays, NULL);
    const Py_ssize_t known = items(&arrays, reached, "reached", 1, 1);
    if (known < 0 || !doubles(&arrays, sums, "sums", count, WRITTEN) || (room = room_for(&arrays, 4 * count)) == NULL)
        return done(&arrays, NULL);
    double *rate = room, *from = room + count, *term = from + count, *sum = term + count;
    memcpy(rate, arrays.view[0].buf, count * D); /* wherever they begin */
    memcpy(from, arrays.view[1].buf, count * D);
    int fit = known > 0;
    for (Py_ssize_t i = 0; i < count && fit; i++) fit = from[i] >= 0.0 && from[i] <= 1e15;
    if (!fit) {
        PyErr_SetString(PyExc_ValueError, "poisson: no first terms, or nothing reached");
        return done(&arrays, NULL);
    }
    memset(sum, 0, count * D);
    for (Py_ssize_t k = terms; k >= 0; k--) {
        for (Py_ssize_t i = 0; i < count; i++) {
            const Py_ssize_t place = (Py_ssize_t)from[i] + k;
            term[i] = double_at(arrays.view[2].buf, place < known ? place : known - 1);
        }
        for (Py_ssize_t i = 0; i < count; i++) sum[i] = sum[i] * (rate[i] / (from[i] + ((double)k + 1.0))) + term[i];
    }
    memcpy(arrays.view[3].buf, sum, count * D);
    return done(&arrays, Py_NewRef(Py_None));
}
