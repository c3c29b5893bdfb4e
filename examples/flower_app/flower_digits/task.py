"""The net, its training and its data: scikit-learn's handwritten digits, of which a node holds two."""

from functools import cache

import numpy as np
from sklearn.datasets import load_digits

INPUTS, HIDDEN, CLASSES, BATCH = 64, 32, 10, 32


def new_model(seed=7):
    """Returns the arrays of a net with one layer of tanh units."""
    rng = np.random.default_rng(seed)
    first, second = rng.normal(0, INPUTS**-0.5, (INPUTS, HIDDEN)), rng.normal(0, HIDDEN**-0.5, (HIDDEN, CLASSES))
    arrays = {"first": first, "first-offset": np.zeros(HIDDEN), "second": second, "second-offset": np.zeros(CLASSES)}
    return {name: array.astype(np.float32) for name, array in arrays.items()}


@cache
def digits():
    """Returns images and labels; every fifth is for tests."""
    images, labels = load_digits(return_X_y=True)
    return (images / 16.0).astype(np.float32), labels


def train_data(partition, partitions):
    """Returns the images and labels of one node: those of two digits, shared with other nodes of the same digits."""
    images, labels = digits()
    held = np.isin(labels, (partition % 10, (partition + 1) % 10)) & (np.arange(len(labels)) % 5 > 0)
    rows = np.flatnonzero(held)[partition // 10 :: 1 + (partitions - 1 - partition % 10) // 10]
    return images[rows], labels[rows]


def test_data():
    """Returns the images and labels for tests, of all digits."""
    images, labels = digits()
    return images[::5], labels[::5]


def outputs(model, images):
    """Returns the activations of the hidden layer, and the chances of the classes."""
    hidden = np.tanh(images @ model["first"] + model["first-offset"])
    scores = hidden @ model["second"] + model["second-offset"]
    chances = np.exp(scores - scores.max(axis=1, keepdims=True))
    return hidden, chances / chances.sum(axis=1, keepdims=True)


def train(model, data, epochs, rate, seed, proximal_mu=0.0):
    """Trains the arrays in place by gradient descent; returns the mean loss. `proximal_mu`: pull towards the start."""
    images, labels = data
    start = {name: array.copy() for name, array in model.items()}
    rng, losses = np.random.default_rng(seed), []
    for _ in range(epochs):
        for batch in np.array_split(rng.permutation(len(labels)), -(-len(labels) // BATCH)):
            hidden, error = outputs(model, images[batch])
            rows = np.arange(len(batch))
            losses.append(-np.log(error[rows, labels[batch]] + 1e-9).mean())
            error[rows, labels[batch]] -= 1.0
            error /= len(batch)
            back = (error @ model["second"].T) * (1.0 - hidden**2)
            slopes = (images[batch].T @ back, back.sum(axis=0), hidden.T @ error, error.sum(axis=0))
            for name, slope in zip(model, slopes, strict=True):
                model[name] -= np.float32(rate) * (slope + np.float32(proximal_mu) * (model[name] - start[name]))
    return float(np.mean(losses))


def test(model, data):
    """Returns loss and accuracy."""
    images, labels = data
    _, chances = outputs(model, images)
    loss = -np.log(chances[np.arange(len(labels)), labels] + 1e-9).mean()
    return float(loss), float((chances.argmax(axis=1) == labels).mean())
