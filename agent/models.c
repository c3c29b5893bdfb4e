/* Models on their way: floats of four bytes or of eight, which may begin anywhere. */
#include "models.h"

#include <math.h>
#include <string.h>

static char *put(char *end, const char *what, Py_ssize_t size) {
    memcpy(end, what, size);
    return end + size;
}

static double double_at(const char *text, Py_ssize_t k) {
    double number;
    memcpy(&number, text + k * D, D);
    return number;
}

int below(double bound, const char *text, Py_ssize_t count) {
    int beyond = 0;
    for (Py_ssize_t k = 0; k < count; k++) beyond |= !(fabs(double_at(text, k)) < bound);
    return !beyond;
}

Py_ssize_t place_at(const char *places, Py_ssize_t k) {
    Py_ssize_t place;
    memcpy(&place, places + k * sizeof place, sizeof place);
    return place;
}

int models_travel(const Models *models) {
    const Py_ssize_t first = models->first, last = models->last;
    return models->count > 0 && models->count <= models->rows && (first == 0 || first == VALUE)
        && (last == VALUE || last == MODEL) && first < last && (models->item == sizeof(float) || models->item == D);
}

/* Of one row, rounded to the nearest. */
static char *narrow(const Models *models, const char *from, Py_ssize_t count, char *end) {
    if (models->item == D) return put(end, from, count * D);
    for (Py_ssize_t k = 0; k < count; k++) {
        const float number = (float)double_at(from, k);
        memcpy(end + k * sizeof number, &number, sizeof number);
    }
    return end + count * sizeof(float);
}

static void widen(const Models *models, const char *from, Py_ssize_t count, char *to) {
    if (models->item == D) put(to, from, count * D);
    else
        for (Py_ssize_t k = 0; k < count; k++) {
            float number;
            memcpy(&number, from + k * sizeof number, sizeof number);
            const double wide = number;
            memcpy(to + k * D, &wide, D);
        }
}

/* One part of what is brought, for every row; 0 if it is not finite. */
static int spread(const Models *models, const char *brought, Py_ssize_t count, char *to) {
    widen(models, brought, count, to);
    if (!below(INFINITY, to, count)) return 0;
    for (Py_ssize_t m = 1; m < models->rows; m++) put(to + m * count * D, to, count * D);
    return 1;
}

int hear_model(const Models *models, const char *brought, Rows *rows) {
    char *room = models->heard;
    if (models->first < VALUE) {
        if (!spread(models, brought, VALUE, room)) return 0;
        rows->value = room;
        room += models->rows * VALUE * D;
        brought += VALUE * models->item;
    }
    if (models->last > VALUE) {
        if (!spread(models, brought, DENSITY, room)) return 0;
        rows->density = room;
    }
    return 1;
}

int upload_models(const Models *models, const Rows *rows, const char *places, char *end) {
    for (Py_ssize_t k = 0; k < models->count; k++) {
        const Py_ssize_t m = place_at(places, k);
        const char *value = rows->value + m * VALUE * D, *density = rows->density + m * DENSITY * D;
        if (models->first < VALUE) {
            if (!below(models->largest, value, VALUE)) return 0;
            end = narrow(models, value, VALUE, end);
        }
        if (models->last > VALUE) {
            if (!below(models->largest, density, DENSITY)) return 0;
            end = narrow(models, density, DENSITY, end);
        }
    }
    return 1;
}

void report_models(const Models *models, const Rows *rows, char *end) {
    for (Py_ssize_t m = 0; m < models->rows; m++) {
        end = put(end, rows->value_out + m * VALUE * D, VALUE * D);
        end = put(end, rows->density_out + m * DENSITY * D, DENSITY * D);
    }
}
