FROM debian:trixie-slim

LABEL org.opencontainers.image.title="wovenfab" \
      org.opencontainers.image.description="Predicts how woven fabrics stretch, shear, bend, slip and dissipate" \
      org.opencontainers.image.licenses="MIT" \
      org.opencontainers.image.authors="wovenfab contributors" \
      org.opencontainers.image.base.name="debian:trixie-slim"

COPY env/packages.txt /tmp/packages.txt
RUN apt-get update && \
    sed 's/#.*//' /tmp/packages.txt | \
    DEBIAN_FRONTEND=noninteractive xargs apt-get install --yes --no-install-recommends && \
    rm -rf /var/lib/apt/lists/* /tmp/packages.txt

COPY . /opt/wovenfab
RUN python3 -m pip install --no-deps --no-build-isolation --no-cache-dir \
    --break-system-packages --root-user-action=ignore /opt/wovenfab

# A home for weaver or any other user that docker run --user names: caches of compiled forms.
RUN useradd --create-home weaver && chmod 1777 /home/weaver && install -d -o weaver -g weaver /work
ENV HOME=/home/weaver \
    LANG=C.UTF-8 \
    OMP_NUM_THREADS=1 \
    OMPI_MCA_btl=self,sm \
    PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe
USER weaver
WORKDIR /work
ENTRYPOINT ["wovenfab"]
CMD ["--help"]
