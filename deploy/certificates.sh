#!/usr/bin/env bash
# Certificates for mutual TLS: a small authority, and a certificate for each common name given.
usage() {
    cat <<'TEXT'
usage: certificates.sh [--folder DIR] [--days N] [--renew-before N] [--host NAME]...
                       [--router ENDPOINT] [--force] NAME...
       certificates.sh [--folder DIR] --list

NAME is a role, or ROLE.ROBOT for one robot alone:
  router                 the router; --host names by which others reach it
  robot                  the robot's driver, which publishes readings
  bridge, coordinator    the processes of these names
  worker, worker-X       workers of one machine; the name is their --name
  ros2                   AMCL's node in ROS 2
  viewer, operator       people: who may look, and who may command as well

Makes NAME.pem, NAME.key (readable by its owner alone) and, for clients, NAME.toml with the
settings. Certificates that are still good are kept, so it may be run again at any time.

  --folder DIR        where the files are (certificates)
  --days N            how long a certificate is good (365)
  --renew-before N    make it anew if it is good for no more than N days (30)
  --force             make it anew in any case
  --host NAME         DNS name or IP address of the router, may be repeated; localhost always is
                      one; without it the names of the certificate there is
  --router ENDPOINT   endpoint in the settings of clients (tls/ first --host :7447)
  --list              say how long each certificate is good
TEXT
}

set -euo pipefail
umask 077

readonly ROLES='robot bridge coordinator ros2 viewer operator worker'
readonly NAME_PATTERN="^(router|(${ROLES// /|}(-[A-Za-z0-9_]+)*)(\.[A-Za-z0-9_]+(-[A-Za-z0-9_]+)*)?)$"
readonly AUTHORITY_DAYS=7300

folder=certificates days=365 renew_before=30 router_endpoint='' force=no list=no
hosts=() names=()

fail() {
    echo "certificates.sh: $1" >&2
    exit 2
}

whole_number() { # OPTION VALUE
    [[ $2 =~ ^[1-9][0-9]{0,3}$ ]] && (($2 <= AUTHORITY_DAYS)) ||
        fail "$1 $2: give a number of days from 1 to $AUTHORITY_DAYS"
}

read_arguments() {
    while (($#)); do
        case $1 in
            --folder | --days | --renew-before | --host | --router)
                (($# > 1)) && [[ -n $2 ]] || fail "$1 needs a value (see --help)"
                ;;&
            --folder) folder=$2 && shift ;;
            --days) whole_number "$1" "$2" && days=$2 && shift ;;
            --renew-before) whole_number "$1" "$2" && renew_before=$2 && shift ;;
            --router) router_endpoint=$2 && shift ;;
            --host)
                [[ $2 =~ ^[A-Za-z0-9.:-]+$ ]] || fail "--host $2: give a DNS name or an IP address"
                hosts+=("$2") && shift
                ;;
            --force) force=yes ;;
            --list) list=yes ;;
            -h | --help) usage && exit 0 ;;
            -*) fail "unknown option $1 (see --help)" ;;
            *) names+=("$1") ;;
        esac
        shift
    done
    ((days > renew_before)) ||
        fail "--days $days: give --renew-before with fewer days as well, it is $renew_before"
    [[ $list == yes ]] || ((${#names[@]})) || fail "no NAME given (see --help)"
    local name
    for name in "${names[@]}"; do
        [[ $name =~ $NAME_PATTERN ]] ||
            fail "'$name' is no role: router, ${ROLES// /, } or worker-X, or one of these with .ROBOT"
        ((${#name} <= 64)) || fail "'$name': a common name has at most 64 letters"
    done
}

quietly() { # runs openssl, which speaks only when something is wrong
    local said
    said=$(openssl "$@" 2>&1) || fail "openssl $1 failed: $said"
}

new_key() { # FILE
    quietly genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1"
}

make_authority() {
    if [[ -f $folder/authority.pem ]]; then
        [[ -f $folder/authority.key ]] ||
            fail "$folder/authority.key is missing: certificates are made where the authority's key is kept"
        return
    fi
    [[ ! -e $folder/authority.key ]] || fail "$folder has authority.key but no authority.pem"
    new_key "$folder/authority.key"
    quietly req -x509 -new -key "$folder/authority.key" -sha256 -days "$AUTHORITY_DAYS" \
        -subj "/CN=Cluster-MCL authority $(openssl rand -hex 4)" -addext "basicConstraints=critical,CA:TRUE,pathlen:0" \
        -addext "keyUsage=critical,keyCertSign,cRLSign" -out "$folder/authority.pem"
    chmod 644 "$folder/authority.pem"
    echo "authority: made, good for $((AUTHORITY_DAYS / 365)) years; keep $folder/authority.key off the robots"
}

alternative_names() {
    local host
    printf 'DNS:localhost,IP:127.0.0.1,IP:::1'
    for host in "${hosts[@]}"; do
        if [[ $host =~ ^[0-9.]+$ || $host == *:* ]]; then
            printf ',IP:%s' "$host"
        else
            printf ',DNS:%s' "$host"
        fi
    done
}

extensions() { # NAME
    echo 'basicConstraints = critical,CA:FALSE'
    echo 'keyUsage = critical,digitalSignature'
    if [[ $1 == router ]]; then
        # A client's certificate cannot pose as the router, nor the router's as a client.
        echo 'extendedKeyUsage = serverAuth'
        echo "subjectAltName = $(alternative_names)"
    else
        echo 'extendedKeyUsage = clientAuth'
    fi
}

is_good() { # NAME: complete, of this authority, of these hosts, and for long enough
    local certificate=$folder/$1.pem
    [[ $force == no && -f $certificate && -f $folder/$1.key ]] || return 1
    openssl verify -CAfile "$folder/authority.pem" "$certificate" >/dev/null 2>&1 || return 1
    openssl x509 -in "$certificate" -noout -checkend $((renew_before * 86400)) >/dev/null || return 1
    [[ $(openssl x509 -in "$certificate" -noout -pubkey) == "$(openssl pkey -in "$folder/$1.key" -pubout)" ]] ||
        return 1
    [[ $1 != router ]] || has_all_hosts "$certificate"
}

remember_hosts() { # of the router's certificate, unless they were given
    local found
    ((${#hosts[@]} == 0)) && [[ -f $folder/router.pem ]] || return 0
    found=$(openssl x509 -in "$folder/router.pem" -noout -ext subjectAltName |
        grep -oE '(DNS|IP Address):[^, ]+' | cut -d: -f2- |
        grep -vxE 'localhost|127\.0\.0\.1|0:0:0:0:0:0:0:1' || true)
    [[ -z $found ]] || mapfile -t hosts <<<"$found"
}

has_all_hosts() { # CERTIFICATE
    local host kind
    for host in "${hosts[@]}"; do
        kind=-checkhost
        [[ ! $host =~ ^[0-9.]+$ && $host != *:* ]] || kind=-checkip
        openssl x509 -in "$1" -noout "$kind" "$host" | grep -q ' does match' || return 1
    done
}

make_certificate() { # NAME
    local made=$folder/.$1.new
    new_key "$made.key"
    quietly req -new -key "$made.key" -subj "/CN=$1" -out "$made.csr"
    extensions "$1" >"$made.ext"
    quietly x509 -req -in "$made.csr" -CA "$folder/authority.pem" -CAkey "$folder/authority.key" \
        -set_serial "0x$(openssl rand -hex 16)" -sha256 -days "$days" -extfile "$made.ext" \
        -out "$made.pem"
    chmod 644 "$made.pem"
    mv "$made.key" "$folder/$1.key"
    mv "$made.pem" "$folder/$1.pem"
}

write_settings() { # NAME
    local here endpoint=${router_endpoint:-tls/${hosts[0]:-localhost}:7447}
    here=$(cd "$folder" && pwd)
    {
        echo "# Settings of a client with the certificate $1.pem: clustermcl ... --settings $1.toml"
        [[ $1 != *.* ]] || printf '[robot]\nname = "%s"\n\n' "${1#*.}"
        printf '[zenoh]\nrouter = "%s"\n' "$endpoint"
        printf 'tls_ca_certificate = "%s"\n' "$here/authority.pem"
        printf 'tls_certificate = "%s"\ntls_private_key = "%s"\n' "$here/$1.pem" "$here/$1.key"
    } >"$folder/$1.toml"
}

good_until() { # CERTIFICATE
    openssl x509 -in "$1" -noout -enddate | cut -d= -f2
}

show_all() {
    local certificate note
    [[ -f $folder/authority.pem ]] || fail "$folder/authority.pem: no such file"
    for certificate in "$folder"/*.pem; do
        note=''
        openssl x509 -in "$certificate" -noout -checkend $((renew_before * 86400)) >/dev/null ||
            note=" (renew it)"
        openssl x509 -in "$certificate" -noout -checkend 0 >/dev/null || note=" (expired)"
        echo "$(basename "$certificate" .pem): good until $(good_until "$certificate")$note"
    done
}

main() {
    read_arguments "$@"
    command -v openssl >/dev/null || fail "openssl is not installed"
    if [[ $list == yes ]]; then
        show_all
        return
    fi
    mkdir -p "$folder" 2>/dev/null && [[ -w $folder ]] || fail "$folder: cannot write there"
    make_authority
    remember_hosts
    trap 'rm -f "$folder"/.*.new.*' EXIT
    local name
    for name in "${names[@]}"; do
        if is_good "$name"; then
            echo "$name: kept, good until $(good_until "$folder/$name.pem")"
        else
            make_certificate "$name"
            echo "$name: made, good until $(good_until "$folder/$name.pem")"
        fi
        [[ $name == router || -f $folder/$name.toml ]] || write_settings "$name"
    done
}

main "$@"
