"""Reads /metrics with the package prometheus_client and prints the samples as JSON.

    python metrics.py URL

Lines that are neither samples nor metadata comments are reported as unread.
"""

import json
import sys
import urllib.request

from prometheus_client.parser import text_string_to_metric_families


def main(url):
    with urllib.request.urlopen(url, timeout=30) as response:
        kind, text = response.headers["content-type"], response.read().decode("utf-8")
    families = list(text_string_to_metric_families(text))
    samples = [sample for family in families for sample in family.samples]
    lines = text.splitlines()
    comments = [line for line in lines if line.startswith("# ")]
    unread = [line for line in lines if line not in comments and line.split("{")[0].split(" ")[0] not in {s.name for s in samples}]
    json.dump(
        {
            "content_type": kind,
            "lines": len(lines) - len(comments),
            "unread": unread,
            "without_help": [family.name for family in families if not family.documentation or family.type == "unknown"],
            "samples": [[sample.name, sample.labels, sample.value] for sample in samples],
        },
        sys.stdout,
    )


main(*sys.argv[1:])
