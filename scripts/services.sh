#!/usr/bin/env bash
# See that PostgreSQL, RabbitMQ and Node are there for the tests that need them; on Debian they are
# installed and started when missing. Anything else is left to the tests, which say what they lack.
set -u
listening() { (exec 3<>"/dev/tcp/127.0.0.1/$1") 2>/dev/null; }
debian() { command -v apt-get >/dev/null 2>&1 && [ "$(id -u)" = 0 ]; }
install() { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@"; }

command -v node >/dev/null 2>&1 || { debian && install nodejs npm; } >&2
if ! listening 5432; then
  { command -v pg_ctlcluster >/dev/null 2>&1 || { debian && install postgresql; }; } >&2
  cluster=$(ls /etc/postgresql 2>/dev/null | tail -n 1)
  [ -n "$cluster" ] && pg_ctlcluster --skip-systemctl-redirect "$cluster" main start >&2
fi
if ! listening 5672; then
  { command -v rabbitmq-server >/dev/null 2>&1 || { debian && install rabbitmq-server; }; } >&2
  command -v rabbitmq-server >/dev/null 2>&1 && rabbitmq-server -detached >&2
fi
for port in 5432 5672; do
  for _ in $(seq 60); do listening "$port" && break; sleep 0.5; done
  listening "$port" || echo "nothing listens on 127.0.0.1:$port" >&2
done
exit 0
