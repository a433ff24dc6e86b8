#!/bin/sh
# Starts one `scatola` command in the image.
set -eu
# numba refuses a cache it cannot write to, and the image's file system is read-only: give it a copy.
cp -r /opt/scatola/var/numba "$NUMBA_CACHE_DIR" 2>/dev/null || mkdir -p "$NUMBA_CACHE_DIR"
# The object store's library reads its credentials from the environment alone.
secret=/run/secrets/aws_secret_access_key
if [ -f "$secret" ]; then
	AWS_SECRET_ACCESS_KEY=$(cat "$secret")
	export AWS_SECRET_ACCESS_KEY
fi
exec scatola "$@"
