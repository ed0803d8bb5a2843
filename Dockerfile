# Unattended runs and the emulated cell, without the terminal application's screen and without a browser.
#
#     docker build --tag cellapp .
#     docker run --rm --volume "$PWD:/work" --user "$(id -u):$(id -g)" cellapp init --demo

FROM python:3.11.11-slim-bookworm AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY cellapp cellapp
COPY drivers drivers
COPY profiles profiles
COPY tests/fixtures/ur10-6d tests/fixtures/ur10-6d
COPY tests/fixtures/ur10-real tests/fixtures/ur10-real
COPY tests/fixtures/ur10-real-d tests/fixtures/ur10-real-d
COPY tests/fixtures/ur5-real tests/fixtures/ur5-real
RUN python -m pip wheel --no-cache-dir --no-deps --wheel-dir /wheel .

FROM python:3.11.11-slim-bookworm
RUN --mount=type=bind,from=build,source=/wheel,target=/wheel \
    python -m pip install --no-cache-dir /wheel/*.whl \
    && useradd --create-home --uid 10001 cellapp \
    && install --directory --owner=cellapp /work
# one thread of linear algebra a process: the matrices are small, and more threads wait for one another
ENV OMP_NUM_THREADS=1 PYTHONUNBUFFERED=1
USER 10001
WORKDIR /work
ENTRYPOINT ["cellapp"]
CMD ["--help"]
