# Heliarch with report and studies, without a compiler or git. Build: docker build -t heliarch .
FROM python:3.11-slim AS build
WORKDIR /source
COPY . .
RUN python -m venv /opt/heliarch \
 && /opt/heliarch/bin/python -m pip install --no-cache-dir --constraint constraints.txt ".[compare,keys,modbus,report]"

FROM python:3.11-slim
COPY --from=build /opt/heliarch /opt/heliarch
RUN useradd --create-home heliarch && install -d -o heliarch /home/heliarch/runs
USER heliarch
ENV PATH=/opt/heliarch/bin:$PATH
# Runs are written to the folder `runs` of the working folder, which is kept in a volume.
WORKDIR /home/heliarch
VOLUME /home/heliarch/runs
ENTRYPOINT ["heliarch"]
CMD ["--help"]
