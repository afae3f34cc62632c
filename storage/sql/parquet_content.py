"""The content of a Parquet file in memory, as a table of a catalogue."""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Self

import pyarrow as pa

if TYPE_CHECKING:
    import pyarrow.dataset as ds

ROW_GROUP = 50_000  # rows that are read together


class ParquetContent:
    """The content of a Parquet file in memory: whatever becomes of the file on the disk, it has the rows that it had.

    Parameters
    ----------
    content : pa.Buffer
        Of the file.

    Examples
    --------
    >>> file = ParquetContent.of(pa.table({"unit": ["FOG-0231", "FOG-0232"]}))
    >>> file.reader().read_all()["unit"].to_pylist()
    ['FOG-0231', 'FOG-0232']
    """

    def __init__(self, content: pa.Buffer) -> None:
        import pyarrow.parquet as pq  # only where there is a table of this kind

        self.content = content
        self.file = pq.ParquetFile(pa.BufferReader(content))
        self.schema = self.file.schema_arrow.remove_metadata()

    @classmethod
    def of(cls, table: pa.Table) -> Self:
        """A table as the content of a file, with its metadata."""
        import pyarrow.parquet as pq

        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd", row_group_size=ROW_GROUP)
        return cls(sink.getvalue())

    @property
    def metadata(self) -> dict[bytes, bytes]:
        """Metadata of the schema."""
        return self.file.schema_arrow.metadata or {}

    def reader(self, rows: int = ROW_GROUP) -> pa.RecordBatchReader:
        """The rows in batches, without the metadata."""
        return pa.RecordBatchReader.from_batches(self.schema, self.file.iter_batches(rows))

    def dataset(self) -> "ds.Dataset":
        """The rows as a data set of Arrow, whose texts are encoded by dictionaries."""
        import pyarrow.dataset as ds  # only where a table is put

        texts = [field.name for field in self.schema if field.type == pa.string()]
        kind = ds.ParquetFileFormat(read_options=ds.ParquetReadOptions(dictionary_columns=texts))
        fragment = kind.make_fragment(pa.BufferReader(self.content))
        return ds.FileSystemDataset([fragment], fragment.physical_schema.remove_metadata(), kind)

    def up_to(self, column: str, lasts: Iterable[str]) -> Iterator[pa.Table]:
        """The rows up to each of some increasing values of a column, by which the rows are sorted; in one pass.

        >>> file = ParquetContent.of(pa.table({"unit": ["A", "B", "B", "C"]}))
        >>> [rows.num_rows for rows in file.up_to("unit", ["A", "B", "D"])]
        [1, 2, 1]
        """
        import pyarrow.compute as pc

        batches = self.reader()
        left = self.schema.empty_table()
        for last in lasts:
            found = [left]
            while True:
                within = pc.sum(pc.less_equal(found[-1][column], last), min_count=0).as_py()
                if within < found[-1].num_rows:
                    left = found[-1].slice(within)
                    found[-1] = found[-1].slice(0, within)
                    break
                batch = next(batches, None)
                if batch is None:
                    left = self.schema.empty_table()
                    break
                found.append(pa.Table.from_batches([batch]))
            yield pa.concat_tables(found)
