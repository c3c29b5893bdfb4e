# Three images of one source tree, each with what its process needs and no more:
#   agent     NumPy, msgspec, Zenoh           python -m meanflock.agent, python -m meanflock.leader
#   world     + the Prometheus client         python -m meanflock.worldsim
#   station   + Rerun, PyArrow, the CLI       python -m meanflock.groundstation, meanflock
# docker build --target agent -t meanflock-agent:local .
# Every process imports the plug-ins of a flight. With EXTRAS of meanflock (torch) or other PACKAGES that a learner imports,
# all three images have the same libraries, in one layer that they share.
ARG BASE_IMAGE=python:3.12-slim
ARG EXTRAS
ARG PACKAGES
# Empty, or the stage that has them.
ARG ADDED=${EXTRAS}${PACKAGES}
ARG ADDED=${ADDED:+extended}

FROM ${BASE_IMAGE} AS base
ENV PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1 \
    OPENBLAS_NUM_THREADS=1 \
    HOME=/tmp \
    PATH=/venv/bin:$PATH
# The slim images leave out the standard library's bytecode, and nothing may write it later: every start would compile.
RUN python -m compileall -q -x '/(test|tests|idlelib|lib2to3|site-packages)/' \
    "$(python -c 'import sysconfig; print(sysconfig.get_path("stdlib"))')"

# ---- builders: dependencies first (their layers change with the pins only), then the code ----------------------------
FROM base AS builder
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 \
    PIP_NO_CACHE_DIR=1 \
    PIP_ROOT_USER_ACTION=ignore
# Older versions of pip work, but take twice the time.
RUN python -m venv /venv && { pip install -q 'pip>=25' || true; }
WORKDIR /build

FROM builder AS wheel
COPY . .
# With a compiler the wheel carries all kernels; without one NumPy does their work, with the same bits.
RUN command -v cc >/dev/null || { apt-get -qq update && apt-get -qq install -y --no-install-recommends gcc libc6-dev; } \
    || echo "no C compiler to be had"
RUN pip wheel -q --no-deps --wheel-dir /wheel .

# With no package beside it, pyproject.toml installs as its dependencies alone.
FROM builder AS agent-dependencies
COPY pyproject.toml LICENSE constraints.txt ./
RUN pip install -q -c constraints.txt .

FROM agent-dependencies AS world-dependencies
RUN pip install -q -c constraints.txt '.[world]'

FROM world-dependencies AS station-dependencies
RUN pip install -q -c constraints.txt '.[ground]'

FROM builder AS extended-dependencies
ARG EXTRAS
ARG PACKAGES
ARG PIP_EXTRA_INDEX_URL
COPY pyproject.toml LICENSE constraints-learners.txt ./
RUN pip install -q -c constraints-learners.txt ".[ground${EXTRAS:+,$EXTRAS}]" ${PACKAGES}

FROM ${ADDED:-agent}-dependencies AS agent-venv
COPY --from=wheel /wheel /wheel
RUN pip install -q --no-deps --force-reinstall /wheel/*.whl && pip uninstall -q -y pip

FROM ${ADDED:-world}-dependencies AS world-venv
COPY --from=wheel /wheel /wheel
RUN pip install -q --no-deps --force-reinstall /wheel/*.whl && pip uninstall -q -y pip

FROM ${ADDED:-station}-dependencies AS station-venv
COPY --from=wheel /wheel /wheel
RUN pip install -q --no-deps --force-reinstall /wheel/*.whl && pip uninstall -q -y pip

# ---- what runs --------------------------------------------------------------------------------------------------------
FROM base AS process
RUN groupadd --gid 1000 meanflock \
    && useradd --uid 1000 --gid 1000 --no-create-home --home-dir /tmp --shell /usr/sbin/nologin meanflock \
    && install -d -o meanflock -g meanflock /app /runs
WORKDIR /app
USER 1000:1000
# As process 1, Python leaves by itself on SIGINT (KeyboardInterrupt), but has no handler for SIGTERM.
STOPSIGNAL SIGINT
ENTRYPOINT ["python", "-P", "-m"]

FROM process AS agent
COPY --from=agent-venv /venv /venv
CMD ["meanflock.agent"]

FROM process AS world
COPY --from=world-venv /venv /venv
EXPOSE 7447
CMD ["meanflock.worldsim"]

FROM process AS station
COPY --from=station-venv /venv /venv
EXPOSE 9876
CMD ["meanflock.groundstation"]
