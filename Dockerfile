# Stages: the locked libraries (large, change with the lock), this package (small), the base without what installs, and the
# image that runs.
#   docker build -t elbowroom .
#   docker run --rm -p 127.0.0.1:8080:8080 -e ELBOWROOM_TOKEN=choose-one elbowroom
# docs/docker.md has the rest: read-only and without rights, recordings, another package index.
ARG BASE=python:3.12-slim-bookworm

# hadolint ignore=DL3006
FROM ${BASE} AS libraries
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
WORKDIR /src
# for trim.py, whatever its version
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends binutils && rm -rf /var/lib/apt/lists/*
# without a pip of its own: the one of the base image fills it
RUN python -m venv --without-pip /opt/venv
COPY requirements.lock ./
# The secrets are optional: a pip.conf, and the certificates that it may name.
RUN --mount=type=secret,id=pip,target=/etc/pip.conf --mount=type=secret,id=certificates \
    pip --python /opt/venv/bin/python install --require-hashes --only-binary :all: --no-compile -r requirements.lock
COPY deploy/trim.py ./
RUN python trim.py /opt/venv/lib/python3.*/site-packages

FROM libraries AS package
COPY pyproject.toml README.md LICENSE ./
COPY hrc hrc
COPY app app
COPY assets assets
ENV PYTHONPATH=/opt/elbowroom WARP_CACHE_PATH=/opt/kernels
# Beside the libraries, so that a change of code makes a small layer. The kernels are compiled for every CPU of this
# architecture, so that no start waits for the compiler.
RUN pip --python /opt/venv/bin/python install --no-deps --no-build-isolation --target /opt/elbowroom . \
 && /opt/venv/bin/python -P -c "from hrc.vision.kernels import warm_for_others; warm_for_others()"

# hadolint ignore=DL3006
FROM ${BASE} AS root
# the OpenMP of the robot's dynamics
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 \
 && useradd --uid 10001 --user-group --home-dir /data --create-home --shell /usr/sbin/nologin elbowroom \
 && rm -rf /usr/local/lib/python3.*/site-packages /usr/local/lib/python3.*/ensurepip /usr/local/lib/python3.*/idlelib \
      /usr/local/lib/python3.*/tkinter /usr/local/lib/python3.*/turtledemo /usr/local/include /usr/local/bin/pip* \
      /usr/bin/apt* /usr/bin/dpkg* /usr/bin/perl* /usr/lib/apt /usr/lib/dpkg /usr/lib/*/libapt* /usr/lib/*/perl-base \
      /usr/lib/*/gconv /var/lib/apt /var/lib/dpkg/info /var/cache

FROM scratch AS run
LABEL org.opencontainers.image.title="elbowroom" \
      org.opencontainers.image.description="Push a simulated robot arm in the browser, and watch it yield" \
      org.opencontainers.image.licenses="Apache-2.0"
# all of it, but in one layer that no longer holds what was removed
# hadolint ignore=DL3067
COPY --from=root / /
COPY --from=libraries /opt/venv /opt/venv
COPY --from=package /opt/elbowroom /opt/elbowroom
COPY --from=package /opt/kernels /opt/kernels
ENV PATH=/opt/venv/bin:/usr/local/bin:/usr/bin:/bin LANG=C.UTF-8 PYTHONPATH=/opt/elbowroom PYTHONUNBUFFERED=1 \
    WARP_CACHE_PATH=/opt/kernels MPLCONFIGDIR=/tmp/matplotlib
# A run and the page's imports show that nothing was trimmed that they need, and leave the byte code of all that they load.
RUN python -m app run push --duration 0.1 --out /tmp/run --quiet \
 && python -c "import app.serve.main, app.campaign.command, distributed.cli.dask_worker" && rm -rf /tmp/*
USER 10001
# recordings go here
WORKDIR /data
EXPOSE 8080
# SIGTERM ends the page as well, but as process 1 Python is deaf to it in its first second
STOPSIGNAL SIGINT
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s --retries=3 CMD ["python", "-m", "app.health"]
ENTRYPOINT ["python", "-m", "app"]
# an address that others reach needs a token: ELBOWROOM_TOKEN, or the one that is printed
CMD ["serve", "--host", "0.0.0.0"]
