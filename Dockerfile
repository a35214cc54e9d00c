# mkdir -p runs && docker build -t lidarnaut . && docker run --rm --user "$(id -u)" -v "$PWD/runs:/home/explorer/runs" lidarnaut
FROM python:3.11-slim

# Torch without CUDA, a fraction of the size. For another build: --build-arg TORCH_INDEX=https://download.pytorch.org/whl/cu128
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu

COPY . /source
# Of equal versions pip takes the one with a local label, here torch's "+cpu".
RUN pip install --no-cache-dir --extra-index-url "$TORCH_INDEX" --constraint /source/constraints.txt /source

# Compiled kernels, fonts and results go to a folder that any user may write to.
ENV HOME=/home/explorer SDL_VIDEODRIVER=dummy
RUN useradd --home-dir /home/explorer explorer && mkdir -m 1777 /home/explorer
USER explorer
WORKDIR /home/explorer

CMD ["python", "-m", "lidarnaut.benchmarks.demo"]
