# One image for every role: api, worker, viewer, migrate.
FROM python:3.11-slim AS build
WORKDIR /src
RUN python -m venv /opt/scatola
ENV PATH=/opt/scatola/bin:$PATH
COPY requirements/server.txt requirements/server.txt
RUN pip install --no-cache-dir --require-hashes --no-deps -r requirements/server.txt
COPY . .
RUN pip install --no-cache-dir --no-deps --no-build-isolation . && scatola warm-up

FROM python:3.11-slim
RUN useradd --system --uid 10001 --home-dir /nonexistent scatola
COPY --from=build /opt/scatola /opt/scatola
COPY deploy/entrypoint.sh /usr/local/bin/entrypoint.sh
ENV PATH=/opt/scatola/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1 \
    SCATOLA_HOST=0.0.0.0 \
    SCATOLA_DATA_DIR=/tmp/scatola \
    SCATOLA_SECRETS_DIR=/run/secrets \
    NUMBA_CACHE_DIR=/tmp/numba
USER scatola
ENTRYPOINT ["/usr/local/bin/entrypoint.sh"]
CMD ["serve"]
