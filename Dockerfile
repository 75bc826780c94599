# syntax=docker/dockerfile:1
# The service in a container: `docker build -t revisit .`, then `docker run -p 8000:8000 -v places:/data revisit`.
#
# TORCH is cpu, gpu (CUDA, for REVISIT_DEVICE=cuda) or none: half a gigabyte, for the encoder `compact` on a CPU.
# Any image of Debian or Ubuntu with Python 3.11 and its venv module will do as BASE.
ARG BASE=python:3.11-slim-bookworm

FROM ${BASE} AS packages
# For a mirror. The CPU build of torch is found without it; where it is not, the build stops rather than fetch CUDA.
ARG PIP_EXTRA_INDEX_URL
ARG TORCH=cpu
WORKDIR /opt/revisit
# Only what decides the packages: this layer is made again when they change, not when the program does.
COPY revisit requirements.lock ./
RUN case "$TORCH" in \
        cpu) flavour= ;; gpu) flavour=--gpu ;; none) flavour=--slim ;; \
        *) echo "TORCH is '$TORCH'; it is cpu, gpu or none" >&2; exit 1 ;; \
    esac && PIP_NO_CACHE_DIR=1 ./revisit $flavour set-up

FROM ${BASE}
RUN useradd --system --uid 10001 --home-dir /data --shell /usr/sbin/nologin revisit \
    && install -d -o revisit -g revisit /data
WORKDIR /opt/revisit
COPY --from=packages /opt/revisit/.venv .venv
COPY schemas schemas
COPY worker worker
COPY app app
COPY client client
COPY LICENSE LICENSE
COPY deploy/in-container /usr/local/bin/revisit
# Compiled once here, since the service's user cannot write beside the program.
RUN .venv/bin/python -m compileall -q schemas worker app client && .venv/bin/python -m pip uninstall -q -y pip

# A container is reached from outside, so it listens everywhere and makes an admin key at its first start, which it prints
# once (`docker logs`). REVISIT_OPEN=1 says that none is wanted. TLS is a proxy's (deploy/nginx.conf).
ENV REVISIT_DATA=/data REVISIT_HOST=0.0.0.0 REVISIT_PORT=8000 REVISIT_FIRST_KEY=true REVISIT_LOG=json PYTHONUNBUFFERED=1
USER revisit
VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=15s --timeout=6s --start-period=60s --retries=4 CMD ["revisit", "healthcheck"]
STOPSIGNAL SIGTERM
ENTRYPOINT ["revisit"]
CMD ["serve"]
