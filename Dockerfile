# Three stages: the locked libraries (large, change with the lock), this package (small), and the image that runs.
#   docker build -t elbowroom .
#   docker run --rm -p 127.0.0.1:8080:8080 -e ELBOWROOM_TOKEN=choose-one elbowroom
ARG BASE=python:3.12-slim-bookworm

FROM ${BASE} AS libraries
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
# without a pip of its own: the one of the base image fills it
RUN python -m venv --without-pip /opt/venv
COPY requirements.lock /src/
RUN pip --python /opt/venv/bin/python install --require-hashes --only-binary :all: -r /src/requirements.lock

FROM libraries AS package
WORKDIR /src
COPY pyproject.toml README.md LICENSE ./
COPY hrc hrc
COPY app app
COPY assets assets
# beside the libraries, so that a change of code makes a small layer
RUN pip --python /opt/venv/bin/python install --no-deps --no-build-isolation --target /opt/elbowroom .
# One step compiles the kernels. They serve machines with this one's CPU features; others compile theirs at the start.
ENV PYTHONPATH=/opt/elbowroom WARP_CACHE_PATH=/opt/kernels
WORKDIR /
RUN /opt/venv/bin/python -c "from hrc.cell.cell import Cell; from hrc.config import Config; Cell(Config()).step()"

FROM ${BASE} AS run
LABEL org.opencontainers.image.title="elbowroom" \
      org.opencontainers.image.description="Push a simulated robot arm in the browser, and watch it yield" \
      org.opencontainers.image.licenses="Apache-2.0"
RUN useradd --uid 10001 --user-group --create-home --shell /usr/sbin/nologin elbowroom
COPY --from=libraries /opt/venv /opt/venv
COPY --from=package /opt/elbowroom /opt/elbowroom
COPY --from=package --chown=10001:10001 /opt/kernels /opt/kernels
ENV PATH=/opt/venv/bin:$PATH PYTHONPATH=/opt/elbowroom WARP_CACHE_PATH=/opt/kernels PYTHONUNBUFFERED=1
USER 10001
WORKDIR /home/elbowroom
EXPOSE 8080
# Python as process 1 ignores SIGTERM; SIGINT ends it as Ctrl-C does
STOPSIGNAL SIGINT
ENTRYPOINT ["python", "-m", "app"]
# an address that others reach needs a token: ELBOWROOM_TOKEN, or the one that is printed
CMD ["serve", "--host", "0.0.0.0"]
