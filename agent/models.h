/* Models on their way: brought to all rows, uploaded by some, reported by all. */
#ifndef MEANFLOCK_MODELS_H
#define MEANFLOCK_MODELS_H

#include "message.h"
#include "tables.h"

enum { VALUE = 2 * VALUES, DENSITY = 2 * DENSITIES, MODEL = VALUE + DENSITY, D = sizeof(double) }; /* floats; bytes */

typedef struct {
    Py_ssize_t rows, count; /* of the process; how many models travel */
    Py_ssize_t first, last, item; /* which of their floats, of so many bytes */
    double largest; /* no float that is uploaded is as large */
    char *heard; /* room for what all rows hear */
} Models;

/* Whether such parts of models of those floats are ever sent by so many. */
int models_travel(const Models *models);

/* Has the tick begin with what is brought where the model has it; 0 if that is not finite. */
int hear_model(const Models *models, const char *brought, Rows *rows);

/* Writes what is transmitted of the models of the rows at those places; 0 if one of them cannot be. */
int upload_models(const Models *models, const Rows *rows, const char *places, char *end);

/* Writes what all rows have learned: agent.minds.Minds.models. */
void report_models(const Models *models, const Rows *rows, char *end);

/* Whether so many doubles, which begin anywhere, are all below, |·|; NaN is below nothing. */
int below(double bound, const char *text, Py_ssize_t count);

/* The k-th of places, Py_ssize_t. */
Py_ssize_t place_at(const char *places, Py_ssize_t k);

#endif
