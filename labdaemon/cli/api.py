"""`labdaemon api`: the API in the formats that other programs read."""

from __future__ import annotations

import click


@click.command()
@click.option("--openrpc", "chosen", flag_value="openrpc", help="Commands and what they answer, as OpenRPC.")
@click.option("--asyncapi", "chosen", flag_value="asyncapi", help="Events and their topics, as AsyncAPI.")
@click.option("--jsonschema", "chosen", flag_value="jsonschema", help="Events, parameters and results, as JSON Schema.")
def api(chosen: str | None) -> None:
    """Print a description of events and commands from which other programs can be made.

    A running daemon answers the first one to `rpc.discover`.
    """
    from labdaemon.service.api_documents import document_text

    if chosen is None:
        raise click.UsageError("choose --openrpc, --asyncapi or --jsonschema")
    click.echo(document_text(chosen), nl=False)
