# Untested. Headless, software GL: docker build -t dslab . && docker run -v "$PWD/out:/out" dslab demo --out /out/demo
FROM python:3.13-slim
RUN apt-get update && apt-get install -y --no-install-recommends libegl1 libgl1-mesa-dri && rm -rf /var/lib/apt/lists/*
ENV DSLAB_GL=software
WORKDIR /lab
COPY . .
RUN pip install --no-cache-dir . && dslab warmup
ENTRYPOINT ["dslab"]
