# lidcam in a container, from wheels alone and as a user without rights:
#   docker build --tag lidcam .
#   docker run --rm --volume "$PWD:/data" lidcam process drive.bag out.mcap
# The folder has to be writable for user 1000.
FROM python:3.12-slim AS build
WORKDIR /source
RUN python -m venv /opt/lidcam
COPY constraints-run.txt constraints-compiler.txt .
RUN /opt/lidcam/bin/pip install --no-cache-dir --only-binary :all: --require-hashes --no-deps --requirement constraints-run.txt --requirement constraints-compiler.txt
COPY . .
RUN /opt/lidcam/bin/pip install --no-cache-dir --no-build-isolation --no-deps .
# --build-arg LEFT_OUT="rerun-sdk pyarrow" makes it 0.7 GB smaller: docs/install.md, "Without the viewer".
ARG LEFT_OUT=
RUN /opt/lidcam/bin/pip uninstall --yes ziglang $LEFT_OUT

FROM python:3.12-slim
COPY --from=build /opt/lidcam /opt/lidcam
ENV PATH=/opt/lidcam/bin:$PATH
RUN useradd --create-home --uid 1000 lidcam
USER lidcam
# Builds no image that does not work.
RUN lidcam demo /tmp/demo && rm -r /tmp/demo
WORKDIR /data
ENTRYPOINT ["lidcam"]
